"""A synthetic drive: the car's way, three frontal cameras and a LiDAR on its roof, as on Waymo's, and its files.

They are written atomically, in the layout of datasets/urban/write.py. truth/… holds moving, depth, flow, flow_valid and
flow_dt, as datasets/ground_truth.py reads them; masks of the sky and of what moves stand where real logs have them.
meta.json holds the arguments that made the scene.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from datasets.files.atomic_write import atomic_folder, write_json
from datasets.files.errors import SceneError
from datasets.synthetic.shade import place
from datasets.synthetic.shapes import column, norm
from datasets.synthetic.trace import NOTHING, first_hits, rays, trace
from datasets.synthetic.world import World, moves, turn
from datasets.urban.waymo.processed import OPENCV_TO_WAYMO
from datasets.urban.write import Frame, FrameCamera, write_processed
from rasterizer.camera import Camera

RATE = 10.0  # frames a second
SPEED = 9.0  # metres a second
LANE = -2.2  # y of the way, metres: the right lane
SWAY = 0.15, 0.02  # of the way: metres to the side, radians
FOCAL = 1.07  # × the image's width: 50 degrees from left to right
ASPECT = 2 / 3  # height over width, as 1920 x 1280
YAW = (0.0, np.radians(43.0), -np.radians(43.0))  # of cameras 0 front, 1 front left, 2 front right
PLACES = ((1.6, 0.0, 1.6), (1.5, 0.25, 1.6), (1.5, -0.25, 1.6))  # of the cameras, metres
LIDAR = (1.2, 0.0, 2.2)  # its place, metres
BEAMS, LOWEST, HIGHEST = 48, np.radians(-18.0), np.radians(3.0)  # elevations
STEPS, HALF_TURN = 900, np.radians(100.0)  # azimuths to either side; behind the car no camera looks
REACH = 75.0  # metres
DROPPED = 0.05  # share of beams that do not return
NOISE = 0.02  # metres, standard deviation of the range
SMALLEST = 16  # image width in pixels


def vehicle_to_world(time: float) -> np.ndarray:
    """(4, 4) at a time in seconds."""
    pose = np.eye(4)
    pose[:3, :3] = turn("z", SWAY[1] * np.sin(1.3 * time))
    pose[:3, 3] = SPEED * time, LANE + SWAY[0] * np.sin(0.9 * time), 0.0
    return pose


def camera_at(number: int, time: float, width: int) -> Camera:
    """Camera `number` at a time, `width` pixels wide."""
    height = round(ASPECT * width)
    camera_to_vehicle = np.eye(4)
    camera_to_vehicle[:3, :3] = turn("z", YAW[number])
    camera_to_vehicle[:3, 3] = PLACES[number]
    camera_to_world = vehicle_to_world(time) @ camera_to_vehicle @ OPENCV_TO_WAYMO
    focal = FOCAL * width
    return Camera(width, height, focal, focal, width / 2, height / 2, np.linalg.inv(camera_to_world))


def sweep(world: World, time: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """(points (N, 3), origin (3,)) in the world, metres, of the sweep at `time`."""
    pose = vehicle_to_world(time)
    origin = pose[:3, :3] @ np.array(LIDAR) + pose[:3, 3]
    elevation = np.linspace(LOWEST, HIGHEST, BEAMS)[:, None]
    azimuth = np.linspace(-HALF_TURN, HALF_TURN, STEPS)[None]
    rays = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation) + 0 * azimuth]
    )
    directions = np.einsum("ij,jrc->irc", pose[:3, :3], rays).astype(np.float32)
    placed = place(world, time)
    whole = slice(0, BEAMS), slice(0, STEPS)
    distance, _ = first_hits(column(origin), directions, placed, [whole] * len(placed))
    returned = (distance < REACH) & (rng.random(distance.shape) >= DROPPED)
    measured = distance[returned] + NOISE * rng.standard_normal(int(returned.sum()))
    along = directions[:, returned] / norm(directions[:, returned])
    return origin + (measured * along).T.astype(np.float64), origin


def write_drive(
    folder: Path, *, scene: str, seed: int, size: int, frames: int, progress: Callable[[int, int], None] | None = None
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
            write_processed(temporary, index, frame)
            if progress is not None:
                progress(index + 1, frames)
        write_json(temporary / "meta.json", {"scene": scene, "seed": seed, "size": size, "frames": frames})
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
