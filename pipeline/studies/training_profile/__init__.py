"""Where the CPU seconds of a training go."""
