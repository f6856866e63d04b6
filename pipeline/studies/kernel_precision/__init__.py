"""Work and precision of the kernel: the error and the time of each of its numerical choices."""
