"""How long the rasterizer takes: seeded workloads, and stopwatches for a frame and a training iteration."""
