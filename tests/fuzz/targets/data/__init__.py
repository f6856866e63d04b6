"""Targets that read scenes: folders of data sets, videos, and what is kept of them."""
