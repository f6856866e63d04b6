"""Plots, image strips and files of the report: Markdown, terminal text, HTML."""
