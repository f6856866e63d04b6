"""Timing of the rasterizer: fixed workloads, and the time of a frame and of a training iteration."""
