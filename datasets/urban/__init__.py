"""Driving logs: cameras on a car, LiDAR sweeps and masks, read from the layouts of KITTI and Waymo.

A reader describes a folder as a `DrivingLog` without decoding images or sweeps; assemble.py reads what a run uses and
makes the Scene. Files are read as text, images and arrays of float32: never with pickle.
"""

from __future__ import annotations

from pathlib import Path

from datasets.files.errors import SceneError
from datasets.urban.log import DrivingLog


def open_log(reader: str, path: Path) -> DrivingLog:
    """The log in folder `path`, whose layout is recognised by its files. reader: kitti or waymo."""
    if not path.is_dir():
        raise SceneError(path, "a folder of a driving log", "a file" if path.exists() else "nothing there")
    if reader == "kitti":
        from datasets.urban.kitti import open_kitti

        return open_kitti(path)
    from datasets.urban.waymo import open_waymo

    return open_waymo(path)
