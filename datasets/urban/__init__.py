"""Driving logs: cameras on a car, LiDAR sweeps and masks, read from the layouts of KITTI and Waymo.

A reader describes a folder as a `DrivingLog` without decoding images or sweeps; assemble.py reads what a run uses and
makes the Scene. Files are read as text, images and arrays of float32: never with pickle.
"""
