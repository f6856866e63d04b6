"""Renders the video frames of a static camera; static bodies are traced only once.

For each frame only the screen blocks of changing bodies (`Body.changes`) are traced, against the depth of the static
ones. This equals a full trace because changing bodies cast no shadow and the lights are constant.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np

from datasets.synthetic.shade import Placed, place
from datasets.synthetic.shapes import column
from datasets.synthetic.trace import NOTHING, cast_rays, check_samples, first_hits, flow_of, pool, rays, screen_block
from datasets.synthetic.world import World, moves
from rasterizer.camera import Camera

STRIP_RAYS = 1 << 19  # traced together; each ray takes a few hundred bytes meanwhile, and 16 in the result

Block = tuple[slice, slice]  # rows and columns


def film(
    world: World, camera: Camera, times: Sequence[float] | np.ndarray, *, samples: int = 3
) -> Iterator[np.ndarray]:
    """Images (H, W, 3) uint8 of the world at `times`, equal to trace(), rounded; samples × samples rays a pixel (odd).

    Raises ValueError for a world that the method cannot render: changing bodies that cast shadows, changing lights,
    pixels without any body (a video has no alpha).
    """
    check_samples(samples)
    _check(world, times)
    still = replace(world, bodies=tuple(body for body in world.bodies if not body.changes))
    changing = replace(world, bodies=tuple(body for body in world.bodies if body.changes))
    occluders = place(still, times[0])
    color, depth = _trace_static(still, camera, samples, occluders, times[0])
    picture = to_pixels(pool(color, samples))
    for time in times:
        frame, covered = picture.copy(), []
        for item in place(changing, time):
            block = screen_block(item, camera, 1)
            inside = _scaled(block, samples)
            if depth[inside].size == 0:
                continue
            hits = cast_rays([item], crop(camera, block), samples, occluders, world, time, before=depth[inside])
            hit = hits.owner != NOTHING
            covered.append((block, inside, color[:, *inside].copy(), depth[inside].copy()))
            np.copyto(color[:, *inside], hits.color, where=hit)
            np.copyto(depth[inside], hits.depth, where=hit)
        for block, inside, _, _ in covered:
            frame[block] = to_pixels(pool(color[:, *inside], samples))
        for _, inside, color_before, depth_before in reversed(covered):  # blocks may overlap
            color[:, *inside], depth[inside] = color_before, depth_before
        yield frame


def depth_of(world: World, camera: Camera, time: float) -> np.ndarray:
    """Depth z (H, W) float32 at pixel centres, world units; inf where there is no body."""
    placed = place(world, time)
    blocks = [screen_block(item, camera, 1) for item in placed]
    return first_hits(column(camera.position), rays(camera, 1), placed, blocks)[0]


def to_pixels(color: np.ndarray) -> np.ndarray:
    """(3, H, W) in [0, 1] as (H, W, 3) uint8."""
    return np.rint(255 * color).astype(np.uint8).transpose(1, 2, 0)


def crop(camera: Camera, block: Block) -> Camera:
    """The camera of a block of pixels."""
    rows, columns = block
    return replace(
        camera,
        width=columns.stop - columns.start,
        height=rows.stop - rows.start,
        cx=camera.cx - columns.start,
        cy=camera.cy - rows.start,
    )


def _trace_static(
    still: World, camera: Camera, samples: int, placed: list[Placed], time: float
) -> tuple[np.ndarray, np.ndarray]:
    """Colour (3, H·samples, W·samples) and depth (H·samples, W·samples) of every ray, traced in strips of rows."""
    color = np.empty((3, camera.height * samples, camera.width * samples), dtype=np.float32)
    depth = np.empty(color.shape[1:], dtype=np.float32)
    rows = max(1, STRIP_RAYS // (camera.width * samples**2))
    for top in range(0, camera.height, rows):
        strip = slice(top, min(top + rows, camera.height)), slice(0, camera.width)
        hits = cast_rays(placed, crop(camera, strip), samples, placed, still, time)
        if (hits.owner == NOTHING).any():
            raise ValueError("world: expected something behind every pixel, found a ray that meets nothing")
        inside = _scaled(strip, samples)
        color[:, *inside], depth[inside] = hits.color, hits.depth
    return color, depth


def _check(world: World, times: Sequence[float] | np.ndarray) -> None:
    if not len(times):
        raise ValueError("times: expected one or more, found none")
    if any(body.changes and body.casts_shadow for body in world.bodies):
        raise ValueError("world: expected bodies that change to cast no shadow, found one that does")
    for light in world.lights:
        if any((light.colour(time) != light.colour(times[0])).any() for time in times):
            raise ValueError("world: expected steady lights, found one that changes")


def _scaled(block: Block, factor: int) -> Block:
    rows, columns = block
    return slice(factor * rows.start, factor * rows.stop), slice(factor * columns.start, factor * columns.stop)


Arrays = Iterator[tuple[str, np.ndarray]]
Times = Sequence[float] | np.ndarray


def write_film_truth(path: Path, world: World, camera: Camera, times: Times, flow_dt: float) -> None:
    """Writes the file of one camera, as datasets/ground_truth.py reads it. The same arguments give the same bytes."""
    with ZipFile(path, "w", ZIP_DEFLATED, compresslevel=1) as file:
        for name, array in film_truth(world, camera, times, flow_dt):
            with file.open(f"{name}.npy", "w") as entry:
                np.lib.format.write_array(entry, array)


def film_truth(world: World, camera: Camera, times: Times, flow_dt: float) -> Arrays:
    """The arrays of the file one by one. Depth and flow are float16: errors of 0.05 % and of 0.01 px at 20 px.

    Flow of a body that changes: its visible surface point moves with it to time + flow_dt. Other bodies have none.
    """
    still = depth_of(replace(world, bodies=tuple(b for b in world.bodies if not b.changes)), camera, times[0])
    changing = replace(world, bodies=tuple(body for body in world.bodies if body.changes))
    moving_bodies = [body for body in changing.bodies if moves(body.motion, times)]
    eye, directions = column(camera.position), rays(camera, 1)
    yield "flow_dt", np.array(flow_dt)
    yield "still_depth", still.astype(np.float16)
    for frame, time in enumerate(times):
        placed = place(changing, time)
        blocks = [screen_block(item, camera, 1) for item in placed]
        depth, owner = first_hits(eye, directions, placed, blocks, still)
        flow, valid = np.zeros((2, *owner.shape), np.float16), np.ones(owner.shape, bool)
        moving = np.zeros(owner.shape, bool)
        for index, item in enumerate(placed):
            y, x = np.nonzero(owner == index)
            local = item.pose.to_body(eye + depth[y, x] * directions[:, y, x])
            flow[:, y, x], valid[y, x] = flow_of(item, local, x, y, camera, time + flow_dt)
            moving[y, x] = any(item.body is body for body in moving_bodies)
        yield f"moving_{frame:04d}", moving
        yield f"depth_{frame:04d}", np.where(owner == NOTHING, 0, depth).astype(np.float16)
        yield f"flow_{frame:04d}", flow
        yield f"flow_valid_{frame:04d}", valid
