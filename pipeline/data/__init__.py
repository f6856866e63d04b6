"""Input of a run: the scene in canonical coordinates, points from structure from motion, training images as tensors."""
