"""How the set of Gaussians changes: densification, opacity resets, pruning."""
