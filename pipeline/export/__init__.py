"""Splat files of a trained model for other programs: `python -m pipeline.export RUN FORMAT`."""
