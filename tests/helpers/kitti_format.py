"""Writes a driving log in the layout of waymo/kitti_format.py, which has neither distortion nor masks of what moves."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from datasets.urban.number_files import transformed
from datasets.urban.write import Frame, _append_time, _made, _save, _save_image, _save_mask, _save_truth


def write_kitti_format(folder: Path, index: int, frame: Frame) -> None:
    """Frame `index` in KITTI's format; the sequence is 0, so that an ID is the frame's number."""
    stem = f"{index:07d}"
    _save(folder / "pose" / f"{stem}.txt", frame.vehicle_to_world)
    _append_time(folder, frame.time, index)
    world_to_vehicle = np.linalg.inv(frame.vehicle_to_world)
    lines = {f"P{n}": np.zeros(12) for n in range(5)} | {"R0_rect": np.eye(3).ravel()}
    lines |= {f"Tr_velo_to_cam_{n}": np.eye(3, 4).ravel() for n in range(5)}
    for one in frame.cameras:
        c = one.camera
        lines[f"P{one.number}"] = np.array([[c.fx, 0, c.cx, 0], [0, c.fy, c.cy, 0], [0, 0, 1, 0]]).ravel()
        lines[f"Tr_velo_to_cam_{one.number}"] = (c.world_to_cam @ frame.vehicle_to_world)[:3].ravel()
        _save_image(folder / f"image_{one.number}", stem, one.image)
        _save_mask(folder / f"sky_{one.number}" / f"{stem}.png", one.sky)
        _save_truth(folder / "truth" / f"{stem}_{one.number}.npz", one.truth)
    text = "".join(f"{name}: {' '.join(f'{x:.17g}' for x in values)}\n" for name, values in lines.items())
    _made(folder / "calib" / f"{stem}.txt").write_text(text)
    if frame.points is not None:
        rows = np.zeros((len(frame.points), 6), "<f4")
        rows[:, :3] = transformed(frame.points, world_to_vehicle)
        rows[:, 3] = frame.intensity
        _made(folder / "velodyne" / f"{stem}.bin").write_bytes(rows.tobytes())
