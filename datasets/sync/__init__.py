"""When cameras that were not synchronised started: offsets and drifts of their clocks, from sound or the picture."""
