"""The layouts that other programs leave Waymo Open Dataset in; convert.py makes one from the original files."""
