"""Decisions that a run takes on validation views, before its training.

motion.py       static or dynamic                   short_training.py   what both do: train briefly and compare
time_colour.py  with time-varying colour or without
"""
