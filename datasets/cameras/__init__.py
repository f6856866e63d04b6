"""Cameras as files describe them: poses, intrinsics, lenses."""
