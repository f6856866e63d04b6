"""Gradient clipping: how heavy-tailed the gradients are, and whether clipping their norm improves training."""
