"""Writes a traced scene to disk in the D-NeRF layout, whole or not at all.

transforms_{train,val,test}.json, {train,val}/r_N.png, test/r_NNN.png     as datasets/dnerf.py reads them
test/r_NNN.npz     depth (H, W), flow (2, H, W), flow_valid (H, W) at pixel centres, see trace.Traced
meta.json          how the scene was made
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from datasets.files.atomic_folder import atomic_folder, write_json
from datasets.synthetic.camera_path import ANGLE_X, Shot
from datasets.synthetic.trace import Traced, trace
from datasets.synthetic.world import World
from rasterizer.camera import Camera


def write_scene(world: World, shots: dict[str, list[Shot]], size: int, meta: dict, folder: Path) -> Path:
    """Traces every shot of every split ("train", "val", "test") at size × size pixels into `folder`."""
    with atomic_folder(folder) as draft:
        for split, split_shots in shots.items():
            _write_split(world, split, split_shots, size, meta["flow_dt"], draft)
        write_json(draft / "meta.json", meta)
    return folder


def read_truth(folder: str | Path, view_name: str) -> Traced:
    """What the tracer knew about a test view, e.g. "test/r_000": depth and flow as written, colour from the PNG."""
    stem = Path(folder) / view_name
    rgba = np.moveaxis(np.asarray(Image.open(stem.with_suffix(".png")), dtype=np.float32) / 255, -1, 0)
    with np.load(stem.with_suffix(".npz")) as arrays:
        return Traced(color=rgba[:3] * rgba[3], alpha=rgba[3], **arrays)


def to_rgba(traced: Traced) -> np.ndarray:
    """Straight-alpha image (H, W, 4) uint8.

    Colour is divided by the *rounded* alpha: composed again, it is then within 1/255 of what was traced.
    """
    alpha = np.rint(255 * traced.alpha)
    colour = np.rint(255 * np.clip(255 * traced.color / np.maximum(alpha, 1), 0, 1))
    return np.concatenate([colour, alpha[None]]).transpose(1, 2, 0).astype(np.uint8)


def _write_split(world: World, split: str, shots: list[Shot], size: int, flow_dt: float, folder: Path) -> None:
    (folder / split).mkdir()
    focal = 0.5 * size / np.tan(0.5 * ANGLE_X)
    frames = []
    for index, shot in enumerate(shots):
        name = f"{split}/r_{index:03d}" if split == "test" else f"{split}/r_{index}"
        traced = trace(world, Camera.from_blender(size, size, focal, shot.cam_to_world), shot.time, flow_dt=flow_dt)
        Image.fromarray(to_rgba(traced)).save(folder / f"{name}.png")
        if split == "test":
            np.savez_compressed(
                folder / f"{name}.npz",
                depth=traced.depth.astype(np.float32),
                flow=traced.flow.astype(np.float32),
                flow_valid=traced.flow_valid,
            )
        frame = {"file_path": f"./{name}", "time": shot.time, "transform_matrix": shot.cam_to_world.tolist()}
        if world.is_static:
            del frame["time"]
        frames.append(frame)
    write_json(folder / f"transforms_{split}.json", {"camera_angle_x": ANGLE_X, "frames": frames})
