"""Simulated LiDAR sweeps: beams at fixed angles, with drop-outs and noise of the range."""

from __future__ import annotations

import numpy as np

from datasets.synthetic.drive.rig import LIDAR, vehicle_to_world
from datasets.synthetic.shade import place
from datasets.synthetic.shapes import column, norm
from datasets.synthetic.trace import first_hits
from datasets.synthetic.world import World

BEAMS, LOWEST, HIGHEST = 48, np.radians(-18.0), np.radians(3.0)  # elevations
STEPS, HALF_TURN = 900, np.radians(100.0)  # azimuths to either side; behind the car no camera looks
REACH = 75.0  # metres
DROPPED = 0.05  # share of beams that do not return
NOISE = 0.02  # metres, standard deviation of the range


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
