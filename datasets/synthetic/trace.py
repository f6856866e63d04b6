"""The ray tracer: one image of a world at one time, with exact depth and optical flow.

Ray directions have length 1 along the viewing axis, so that the distance along a ray is the depth z. Each pixel has an
odd number of rays a side. Depth and flow are those of the middle ray, through the pixel's centre; colour and alpha are
averages over all rays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from datasets.synthetic.shade import Placed, place, shade
from datasets.synthetic.shapes import column, norm
from datasets.synthetic.world import World
from rasterizer.camera import Camera

NOTHING = -1  # index of the body for a ray that hits none


@dataclass(frozen=True)
class TracedImage:
    """One traced image, float32. Colour is premultiplied: the sum over the rays that hit a body / all rays."""

    color: np.ndarray  # (3, H, W) in [0, alpha]
    alpha: np.ndarray  # (H, W), the covered part of each pixel
    depth: np.ndarray  # (H, W) z at the pixel's centre, world units; 0 without a body
    flow: np.ndarray  # (2, H, W) pixels right and down to time + flow_dt; 0 where flow_valid is False
    flow_valid: np.ndarray  # (H, W) bool: a body is there, also at time + flow_dt, in front of the camera
    body: np.ndarray  # (H, W) int16 index in World.bodies of the body at the pixel's centre; NOTHING without one


@dataclass(frozen=True)
class RayHits:
    """The nearest hit of each ray, samples × samples rays per pixel. float32 except for `owner`."""

    color: np.ndarray  # (3, H·samples, W·samples), 0 without a hit
    depth: np.ndarray  # (H·samples, W·samples) z, world units; inf without a hit
    owner: np.ndarray  # (H·samples, W·samples) int16: index of the body; NOTHING without a hit


def trace(world: World, camera: Camera, time: float, *, flow_dt: float = 0.01, samples: int = 3) -> TracedImage:
    """The world at `time` seen by `camera`, with samples × samples rays a pixel (samples odd).

    Flow: the visible surface point moves with its body to time + flow_dt and is projected by the same camera.
    """
    placed = place(world, time)
    hits = cast_rays(placed, camera, samples, placed, world, time)
    hit = hits.owner != NOTHING
    centre = (slice(samples // 2, None, samples),) * 2
    depth, owner = np.where(hit, hits.depth, 0)[centre], hits.owner[centre]

    flow = np.zeros((2, camera.height, camera.width), dtype=np.float32)
    flow_valid = np.zeros((camera.height, camera.width), dtype=bool)
    body = np.full_like(owner, NOTHING)
    directions = rays(camera, 1)
    for index, item in enumerate(placed):
        y, x = np.nonzero(owner == index)
        body[y, x] = next(number for number, one in enumerate(world.bodies) if one is item.body)
        local = item.pose.to_body(column(camera.position) + depth[y, x] * directions[:, y, x])
        flow[:, y, x], flow_valid[y, x] = flow_of(item, local, x, y, camera, time + flow_dt)
    return TracedImage(
        color=pool(hits.color, samples),
        alpha=pool(hit.astype(np.float32), samples),
        depth=depth,
        flow=flow,
        flow_valid=flow_valid,
        body=body,
    )


def cast_rays(
    bodies: list[Placed],
    camera: Camera,
    samples: int,
    placed: list[Placed],
    world: World,
    time: float,
    before: np.ndarray | None = None,
) -> RayHits:
    """The nearest hit of each ray among `bodies`, shaded with the shadows of all `placed`.

    before: (H·samples, W·samples) depths; only nearer hits count. None: no bound.
    """
    check_samples(samples)
    eye = column(camera.position)
    directions = rays(camera, samples)
    blocks = [screen_block(item, camera, samples) for item in bodies]
    depth, owner = first_hits(eye, directions, bodies, blocks, before)

    color = np.zeros_like(directions)
    for index, (item, block) in enumerate(zip(bodies, blocks)):
        row, col = np.nonzero(owner[block] == index)
        if row.size == 0:
            continue
        row, col = row + block[0].start, col + block[1].start
        ray_index = row * directions.shape[2] + col
        ray = directions.reshape(3, -1).take(ray_index, axis=1)
        points = eye + depth.take(ray_index) * ray
        sample = row % samples * samples + col % samples
        color.reshape(3, -1)[:, ray_index] = shade(
            item, points, item.pose.to_body(points), -ray / norm(ray), sample, samples**2, placed, world, time
        )
    return RayHits(color=color, depth=depth, owner=owner)


def check_samples(samples: int) -> None:
    """ValueError for an even number, which has no ray through the pixel's centre."""
    if samples < 1 or samples % 2 == 0:
        raise ValueError(f"samples: expected an odd number of rays along a pixel's side, found {samples}")


def rays(camera: Camera, samples: int) -> np.ndarray:
    """World directions (3, H·samples, W·samples) of all rays, each of length 1 along the viewing axis."""
    x = ((np.arange(camera.width * samples) + 0.5) / samples - camera.cx) / camera.fx
    y = ((np.arange(camera.height * samples) + 0.5) / samples - camera.cy) / camera.fy
    right, down, forward = camera.world_to_cam[:3, :3].astype(np.float32)[:, :, None, None]
    return x.astype(np.float32) * right + (y.astype(np.float32)[:, None] * down + forward)


def first_hits(
    eye: np.ndarray,
    directions: np.ndarray,
    bodies: list[Placed],
    blocks: list[tuple[slice, slice]],
    before: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """(depth, index of the body) of each ray's nearest hit in front of `before`; inf and NOTHING without a hit."""
    shape = directions.shape[1:]
    depth = np.full(shape, np.inf, dtype=np.float32) if before is None else before.copy()
    owner = np.full(shape, NOTHING, dtype=np.int16)
    for index, (item, block) in enumerate(zip(bodies, blocks)):
        direction = directions[:, *block]
        distance = item.body.shape.intersect(item.pose.to_body(eye), item.pose.turn_to_body(direction.reshape(3, -1)))
        distance = distance.reshape(direction.shape[1:])
        nearer = (distance > 0) & (distance < depth[block])
        np.copyto(depth[block], distance, where=nearer)
        np.copyto(owner[block], index, where=nearer)
    depth[owner == NOTHING] = np.inf
    return depth, owner


def screen_block(item: Placed, camera: Camera, samples: int) -> tuple[slice, slice]:
    """Rows and columns of the rays that may hit the body: the bounding box of its bounding sphere's image."""
    x, y, z = camera.world_to_cam[:3, :3] @ item.pose.position + camera.world_to_cam[:3, 3]

    def bounds(across: float, focal: float, middle: float, size: int) -> slice:
        if z <= item.radius:  # the sphere reaches the camera's plane: no bound
            return slice(0, size * samples)
        # In the plane of the axis and the sphere's centre, the tangents leave at angle ± asin(radius / distance).
        angle, half = np.arctan2(across, z), np.arcsin(item.radius / np.hypot(across, z))
        low, high = np.clip(focal * np.tan([angle - half, angle + half]) + middle, 0, size) * samples
        return slice(int(np.floor(low)), int(np.ceil(high)))

    return bounds(y, camera.fy, camera.cy, camera.height), bounds(x, camera.fx, camera.cx, camera.width)


def pool(values: np.ndarray, samples: int) -> np.ndarray:
    """The mean over each pixel's samples × samples rays: (…, H·samples, W·samples) -> (…, H, W)."""
    total = np.asarray(sum(values[..., i::samples, j::samples] for i in range(samples) for j in range(samples)))
    return total / np.float32(samples**2)


def flow_of(
    item: Placed, local: np.ndarray, x: np.ndarray, y: np.ndarray, camera: Camera, later: float
) -> tuple[np.ndarray, np.ndarray]:
    """Flow (2, N) in pixels of body points (3, N) at the centres of pixels x, y, and its validity (N,)."""
    pose = item.body.motion(later)
    moved = camera.world_to_cam[:3, :3] @ pose.to_world(local) + camera.world_to_cam[:3, 3:]
    valid = (moved[2] > 0) & (pose.scale > 0)
    z = np.where(valid, moved[2], 1)
    flow = np.stack(
        [camera.fx * moved[0] / z + camera.cx - (x + 0.5), camera.fy * moved[1] / z + camera.cy - (y + 0.5)]
    )
    return np.where(valid, flow, 0), valid
