"""Training: the loop, the steps of an iteration, the state that they change, and the checkpoint of that state."""
