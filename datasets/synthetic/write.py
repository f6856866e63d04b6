"""Writes a photographed synthetic scene in the D-NeRF layout, atomically, with ground truth of its test views.

transforms_{train,val,test}.json, {train,val}/r_N.png, test/r_NNN.png     as datasets/readers/dnerf.py reads them
test/r_NNN.npz     moving, depth, flow, flow_valid, flow_dt, see datasets/ground_truth.py
meta.json          the arguments that made the scene
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from datasets.files.atomic_write import atomic_folder, write_json
from datasets.synthetic.camera_path import ANGLE_X, TimedPose
from datasets.synthetic.trace import TracedImage, trace
from datasets.synthetic.world import World, moves
from rasterizer.camera import Camera


def write_scene(world: World, poses: dict[str, list[TimedPose]], size: int, meta: dict, folder: Path) -> Path:
    """Renders all poses of the splits "train", "val" and "test" at size × size pixels into `folder`."""
    times = [pose.time for split_poses in poses.values() for pose in split_poses]
    moving = [index for index, body in enumerate(world.bodies) if moves(body.motion, times)]
    with atomic_folder(folder, marker="meta.json") as temporary:
        for split, split_poses in poses.items():
            _write_split(world, moving, split, split_poses, size, meta["flow_dt"], temporary)
        write_json(temporary / "meta.json", meta)
    return folder


def to_rgba(traced: TracedImage) -> np.ndarray:
    """Straight-alpha image (H, W, 4) uint8.

    Colour is divided by the rounded alpha, so that composition reproduces the traced colour within 1/255.
    """
    alpha = np.rint(255 * traced.alpha)
    colour = np.rint(255 * np.clip(255 * traced.color / np.maximum(alpha, 1), 0, 1))
    return np.concatenate([colour, alpha[None]]).transpose(1, 2, 0).astype(np.uint8)


def _write_split(
    world: World, moving: list[int], split: str, poses: list[TimedPose], size: int, flow_dt: float, folder: Path
) -> None:
    """moving: indices in world.bodies of the bodies that move."""
    (folder / split).mkdir()
    focal = 0.5 * size / np.tan(0.5 * ANGLE_X)
    frames = []
    for index, pose in enumerate(poses):
        name = f"{split}/r_{index:03d}" if split == "test" else f"{split}/r_{index}"
        traced = trace(world, Camera.from_blender(size, size, focal, pose.cam_to_world), pose.time, flow_dt=flow_dt)
        Image.fromarray(to_rgba(traced)).save(folder / f"{name}.png")
        if split == "test":
            np.savez_compressed(
                folder / f"{name}.npz",
                moving=np.isin(traced.body, moving),
                depth=traced.depth.astype(np.float32),
                flow=traced.flow.astype(np.float32),
                flow_valid=traced.flow_valid,
                flow_dt=np.float64(flow_dt),
            )
        frame = {"file_path": f"./{name}", "time": pose.time, "transform_matrix": pose.cam_to_world.tolist()}
        if world.is_static:
            del frame["time"]
        frames.append(frame)
    write_json(folder / f"transforms_{split}.json", {"camera_angle_x": ANGLE_X, "frames": frames})
