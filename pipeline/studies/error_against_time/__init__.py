"""Mean error of several scenes against the CPU seconds of training."""
