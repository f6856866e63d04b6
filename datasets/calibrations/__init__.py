"""Calibration files of other programs: intrinsics, lens and pose of each camera of a rig, by name.

A module reads one format and returns a `Rig`; `read.py` finds out which. `readings.py` checks by the cameras themselves
whether poses are world-to-camera, `named.py` finds the videos or images of each camera.
"""
