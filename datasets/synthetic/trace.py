"""The ray tracer: one image of a world at one time, with exact depth and optical flow.

Rays have unit length along the viewing axis, so the distance along a ray *is* the depth z. Each pixel has an odd
number of rays a side, so that its middle ray passes through the pixel's centre: depth and flow are that ray's,
exact and without anti-aliasing; colour and alpha are the average of all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from datasets.synthetic.shade import Placed, place, shade
from datasets.synthetic.shapes import column, norm
from datasets.synthetic.world import World
from rasterizer.camera import Camera

NOTHING = -1  # body index of a ray that met none


@dataclass(frozen=True)
class Traced:
    """One traced image, float32. Colour is premultiplied: Σ over rays that met something, / all rays."""

    color: np.ndarray  # (3, H, W) in [0, alpha]
    alpha: np.ndarray  # (H, W), the covered part of each pixel
    depth: np.ndarray  # (H, W) z at the pixel's centre, world units; 0 where nothing is
    flow: np.ndarray  # (2, H, W) pixels right and down to time + flow_dt; 0 where flow_valid is False
    flow_valid: np.ndarray  # (H, W) bool: something is there, and still (and before the camera) at time + flow_dt


def trace(world: World, camera: Camera, time: float, *, flow_dt: float = 0.01, samples: int = 3) -> Traced:
    """The world at `time` seen by `camera`, with samples × samples rays a pixel (samples odd).

    Flow: the surface point seen moves with its body to time + flow_dt and is projected by the same camera.
    """
    if samples < 1 or samples % 2 == 0:
        raise ValueError(f"samples: expected an odd number of rays along a pixel's side, found {samples}")
    eye = column(camera.position)
    rays = _rays(camera, samples)
    placed = place(world, time)
    blocks = [_screen_block(item, camera, samples) for item in placed]
    depth, owner = _first_hits(eye, rays, placed, blocks)

    color = np.zeros_like(rays)
    flow = np.zeros((2, camera.height, camera.width), dtype=np.float32)
    flow_valid = np.zeros((camera.height, camera.width), dtype=bool)
    for index, (item, block) in enumerate(zip(placed, blocks)):
        row, col = np.nonzero(owner[block] == index)
        if row.size == 0:
            continue
        row, col = row + block[0].start, col + block[1].start
        met = row * rays.shape[2] + col
        ray = rays.reshape(3, -1).take(met, axis=1)
        points = eye + depth.take(met) * ray
        local = item.pose.to_body(points)
        sample = row % samples * samples + col % samples
        color.reshape(3, -1)[:, met] = shade(item, points, local, -ray / norm(ray), sample, samples**2, placed, world,
                                             time)

        middle = np.flatnonzero(sample == samples**2 // 2)
        y, x = row[middle] // samples, col[middle] // samples
        flow[:, y, x], flow_valid[y, x] = _flow(item, local[:, middle], x, y, camera, time + flow_dt)

    hit = owner != NOTHING
    centre = slice(samples // 2, None, samples)
    return Traced(color=_pool(color, samples), alpha=_pool(hit.astype(np.float32), samples),
                  depth=np.where(hit, depth, 0)[centre, centre], flow=flow, flow_valid=flow_valid)


def _rays(camera: Camera, samples: int) -> np.ndarray:
    """World directions (3, H·samples, W·samples) of all rays, each of length 1 along the viewing axis."""
    x = ((np.arange(camera.width * samples) + 0.5) / samples - camera.cx) / camera.fx
    y = ((np.arange(camera.height * samples) + 0.5) / samples - camera.cy) / camera.fy
    right, down, forward = camera.world_to_cam[:3, :3].astype(np.float32)[:, :, None, None]
    return x.astype(np.float32) * right + (y.astype(np.float32)[:, None] * down + forward)


def _first_hits(eye: np.ndarray, rays: np.ndarray, placed: list[Placed],
                blocks: list[tuple[slice, slice]]) -> tuple[np.ndarray, np.ndarray]:
    """(depth, index of the body met) of each ray; inf and NOTHING for none."""
    depth = np.full(rays.shape[1:], np.inf, dtype=np.float32)
    owner = np.full(rays.shape[1:], NOTHING, dtype=np.int16)
    for index, (item, block) in enumerate(zip(placed, blocks)):
        direction = rays[:, *block]
        distance = item.body.shape.intersect(item.pose.to_body(eye), item.pose.turn_to_body(direction.reshape(3, -1)))
        distance = distance.reshape(direction.shape[1:])
        nearer = (distance > 0) & (distance < depth[block])
        np.copyto(depth[block], distance, where=nearer)
        np.copyto(owner[block], index, where=nearer)
    return depth, owner


def _screen_block(item: Placed, camera: Camera, samples: int) -> tuple[slice, slice]:
    """Rows and columns of the rays that may meet the body: the image of its bounding sphere, boxed."""
    x, y, z = camera.world_to_cam[:3, :3] @ item.pose.position + camera.world_to_cam[:3, 3]

    def bounds(across: float, focal: float, middle: float, size: int) -> slice:
        if z <= item.radius:  # the sphere reaches the camera's plane: no bound
            return slice(0, size * samples)
        # In the plane of the axis and the sphere's centre, the tangents leave at angle ± asin(radius / distance).
        angle, half = np.arctan2(across, z), np.arcsin(item.radius / np.hypot(across, z))
        low, high = np.clip(focal * np.tan([angle - half, angle + half]) + middle, 0, size) * samples
        return slice(int(np.floor(low)), int(np.ceil(high)))

    return bounds(y, camera.fy, camera.cy, camera.height), bounds(x, camera.fx, camera.cx, camera.width)


def _flow(item: Placed, local: np.ndarray, x: np.ndarray, y: np.ndarray, camera: Camera,
          later: float) -> tuple[np.ndarray, np.ndarray]:
    """Movement (2, N) in pixels of body points (3, N) seen at the centres of pixels x, y; where it exists (N,)."""
    pose = item.body.motion(later)
    moved = camera.world_to_cam[:3, :3] @ pose.to_world(local) + camera.world_to_cam[:3, 3:]
    valid = (moved[2] > 0) & (pose.scale > 0)
    z = np.where(valid, moved[2], 1)
    flow = np.stack([camera.fx * moved[0] / z + camera.cx - (x + 0.5),
                     camera.fy * moved[1] / z + camera.cy - (y + 0.5)])
    return np.where(valid, flow, 0), valid


def _pool(values: np.ndarray, samples: int) -> np.ndarray:
    """The mean over each pixel's samples × samples rays: (…, H·samples, W·samples) -> (…, H, W)."""
    total = sum(values[..., i::samples, j::samples] for i in range(samples) for j in range(samples))
    return total / np.float32(samples**2)
