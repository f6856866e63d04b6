"""Adaptive density control: densification, pruning and opacity resets."""
