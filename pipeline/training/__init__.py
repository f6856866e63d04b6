"""How it is trained: the loop, one file for each of its steps, and the checkpoint it continues from."""
