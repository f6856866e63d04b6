"""Cameras as data sets store them: poses, intrinsics, lens distortion, optical axes."""
