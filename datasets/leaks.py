"""Held-out views that are training views under another name: their numbers say nothing of unseen views."""

from __future__ import annotations

import hashlib

import numpy as np

from datasets.scene import Scene, View

SAME_POSE = 1e-5  # of rotation matrices, and × the extent of positions: files round
SAME_PICTURE = 3.0  # of 255, in the mean: a copy that was compressed again


def trained_test_views(scene: Scene) -> list[tuple[str, str]]:
    """(test view, training view) that show the same: equal pixels, or nearly, from one pose at one time.

    Pictures of one colour do not count.
    """
    by_pixels = {digest: view for view in scene.train if (digest := _digest(view))}
    poses = np.stack([view.camera.world_to_cam for view in scene.train])
    tolerance = SAME_POSE * np.array([1.0, 1.0, 1.0, scene.extent])
    times = np.array([view.time for view in scene.train])
    found = []
    for view in scene.test:
        same = by_pixels.get(_digest(view))
        if same is None and scene.frame_rate is None:
            near = (np.abs(poses - view.camera.world_to_cam) <= tolerance).all(axis=(1, 2))
            near &= np.abs(times - view.time) <= SAME_POSE * scene.duration
            same = next((o for o in (scene.train[i] for i in np.flatnonzero(near)) if _alike(view, o)), None)
        if same is not None and np.ptp(np.asarray(view.image)) > 0:
            found.append((view.name, same.name))
    return found


def _digest(view: View) -> str:
    """Of the pixels; "" where they are not in memory and their file has no checksum."""
    if known := getattr(view.image, "checksum", None):
        return known
    if not getattr(view.image, "keep", True):
        return ""
    return hashlib.blake2b(np.ascontiguousarray(view.image).data, digest_size=16).hexdigest()


def _alike(one: View, other: View) -> bool:
    if one.image.shape != other.image.shape:
        return False
    return float(np.abs(np.asarray(one.image, np.int16) - np.asarray(other.image, np.int16)).mean()) <= SAME_PICTURE
