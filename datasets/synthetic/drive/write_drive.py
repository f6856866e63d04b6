"""Writes a synthetic drive in one of the layouts of real logs, atomically, with ground truth of every image.

The layouts are those of datasets/urban/write.py. truth/… holds moving, depth, flow, flow_valid and flow_dt, as
datasets/ground_truth.py reads them; masks of the sky, and in the processed layout of what moves, stand where the data
of real logs have them. meta.json holds the arguments that made the scene.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from datasets.files.atomic_write import atomic_folder, write_json
from datasets.files.errors import SceneError
from datasets.synthetic.drive.lidar import sweep
from datasets.synthetic.drive.rig import RATE, YAW, camera_at, vehicle_to_world
from datasets.synthetic.trace import NOTHING, rays, trace
from datasets.synthetic.world import World, moves
from datasets.urban.write import WRITERS, Frame, FrameCamera
from rasterizer.camera import Camera

SMALLEST = 16  # image width in pixels


def write_drive(
    folder: Path,
    *,
    scene: str,
    seed: int,
    size: int,
    frames: int,
    layout: str,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Renders `frames` frames of three cameras, `size` pixels wide, into `folder`. The same arguments give the same
    bytes."""
    if size < SMALLEST or frames < 2:
        raise SceneError("scene.size, scene.frames", f"at least {SMALLEST} and 2", f"{size} and {frames}")
    world_rng, lidar_rng = np.random.default_rng(seed).spawn(2)
    module = importlib.import_module(f"datasets.synthetic.scenes.{scene}")
    world = module.build(world_rng)
    times = [frame / RATE for frame in range(frames)]
    moving = [index for index, body in enumerate(world.bodies) if moves(body.motion, times)]
    with atomic_folder(folder, marker="meta.json") as temporary:
        for index, time in enumerate(times):
            cameras = tuple(
                _frame_camera(world, module.sky_color, moving, number, camera_at(number, time, size), time)
                for number in range(len(YAW))
            )
            points, origin = sweep(world, time, lidar_rng)
            frame = Frame(time, vehicle_to_world(time), cameras, points, origin)
            WRITERS[layout](temporary, index, frame)
            if progress is not None:
                progress(index + 1, frames)
        write_json(
            temporary / "meta.json", {"scene": scene, "seed": seed, "size": size, "frames": frames, "layout": layout}
        )
    return folder


def _frame_camera(
    world: World,
    sky_color: Callable[[np.ndarray], np.ndarray],
    moving: list[int],
    number: int,
    camera: Camera,
    time: float,
) -> FrameCamera:
    traced = trace(world, camera, time, flow_dt=1 / RATE)
    image = traced.color + (1 - traced.alpha) * sky_color(rays(camera, 1))
    is_moving = np.isin(traced.body, moving)
    return FrameCamera(
        number,
        camera,
        np.rint(255 * np.clip(image, 0, 1)).astype(np.uint8).transpose(1, 2, 0),
        sky=traced.body == NOTHING,
        moving=is_moving,
        truth={
            "moving": is_moving,
            "depth": traced.depth.astype(np.float32),
            "flow": traced.flow.astype(np.float16),
            "flow_valid": traced.flow_valid,
            "flow_dt": np.array(1 / RATE),
        },
    )
