"""Decisions that a run takes on validation views, before its training: see motion.py."""
