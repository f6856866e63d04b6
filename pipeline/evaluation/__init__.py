"""Evaluation of a model on held-out views: image metrics, flicker, speed, images and videos."""
