"""LiDAR sweeps in training: initial points, targets of depth, and what moves."""
