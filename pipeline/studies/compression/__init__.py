"""Compression of a trained model: pruning by image sensitivity, retraining, 16-bit and 8-bit storage."""
