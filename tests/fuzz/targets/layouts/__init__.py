"""Targets that read folders of other tools, as scene=auto does."""
