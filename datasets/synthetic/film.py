"""Many images of one world through a camera that does not move, for little more than the price of what changes.

Bodies that stay as they are (`Body.changes` is False) are traced once, ray by ray. A frame then traces only the
screen blocks of the bodies that change, against the depth of what stands still. This is exact because such
bodies cast no shadow and the lights are steady: nothing that stands still looks any different for them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from datasets.synthetic.shade import Placed, place
from datasets.synthetic.shapes import column
from datasets.synthetic.trace import NOTHING, cast, check_samples, first_hits, pool, rays, screen_block
from datasets.synthetic.world import World
from rasterizer.camera import Camera

STRIP_RAYS = 1 << 19  # traced at one go: a few hundred bytes a ray are in use meanwhile, 16 afterwards

Block = tuple[slice, slice]  # rows and columns


def film(world: World, camera: Camera, times: Sequence[float], *, samples: int = 3) -> Iterator[np.ndarray]:
    """Images (H, W, 3) uint8 of the world at `times`, one after the other; samples × samples rays a pixel (odd).

    What trace() gives for each time, rounded. Raises ValueError for a world that it would show wrongly: bodies that
    change and cast a shadow, lights that change, places where there is nothing (a video has no alpha).
    """
    check_samples(samples)
    _check(world, times)
    still = replace(world, bodies=tuple(body for body in world.bodies if not body.changes))
    lively = replace(world, bodies=tuple(body for body in world.bodies if body.changes))
    occluders = place(still, times[0])
    color, depth = _expose(still, camera, samples, occluders, times[0])
    picture = to_pixels(pool(color, samples))
    for time in times:
        frame, covered = picture.copy(), []
        for item in place(lively, time):
            block = screen_block(item, camera, 1)
            inside = _scaled(block, samples)
            if depth[inside].size == 0:
                continue
            met = cast([item], crop(camera, block), samples, occluders, world, time, before=depth[inside])
            hit = met.owner != NOTHING
            covered.append((block, inside, color[:, *inside].copy(), depth[inside].copy()))
            np.copyto(color[:, *inside], met.color, where=hit)
            np.copyto(depth[inside], met.depth, where=hit)
        for block, inside, _, _ in covered:
            frame[block] = to_pixels(pool(color[:, *inside], samples))
        for _, inside, color_before, depth_before in reversed(covered):  # blocks may overlap
            color[:, *inside], depth[inside] = color_before, depth_before
        yield frame


def depth_of(world: World, camera: Camera, time: float) -> np.ndarray:
    """Depth z (H, W) float32 at the pixels' centres, world units; inf where nothing is."""
    placed = place(world, time)
    blocks = [screen_block(item, camera, 1) for item in placed]
    return first_hits(column(camera.position), rays(camera, 1), placed, blocks)[0]


def to_pixels(color: np.ndarray) -> np.ndarray:
    """(3, H, W) in [0, 1] as (H, W, 3) uint8."""
    return np.rint(255 * color).astype(np.uint8).transpose(1, 2, 0)


def crop(camera: Camera, block: Block) -> Camera:
    """The camera that sees only a block of pixels, each as before."""
    rows, columns = block
    return replace(
        camera,
        width=columns.stop - columns.start,
        height=rows.stop - rows.start,
        cx=camera.cx - columns.start,
        cy=camera.cy - rows.start,
    )


def _expose(
    still: World, camera: Camera, samples: int, placed: list[Placed], time: float
) -> tuple[np.ndarray, np.ndarray]:
    """Colour (3, H·samples, W·samples) and depth (H·samples, W·samples) of every ray, traced in strips of rows."""
    color = np.empty((3, camera.height * samples, camera.width * samples), dtype=np.float32)
    depth = np.empty(color.shape[1:], dtype=np.float32)
    rows = max(1, STRIP_RAYS // (camera.width * samples**2))
    for top in range(0, camera.height, rows):
        strip = slice(top, min(top + rows, camera.height)), slice(0, camera.width)
        met = cast(placed, crop(camera, strip), samples, placed, still, time)
        if (met.owner == NOTHING).any():
            raise ValueError("world: expected something behind every pixel, found a ray that meets nothing")
        inside = _scaled(strip, samples)
        color[:, *inside], depth[inside] = met.color, met.depth
    return color, depth


def _check(world: World, times: Sequence[float]) -> None:
    if not len(times):
        raise ValueError("times: expected one or more, found none")
    if any(body.changes and body.casts_shadow for body in world.bodies):
        raise ValueError("world: expected bodies that change to cast no shadow, found one that does")
    for light in world.lights:
        if any((light.colour(time) != light.colour(times[0])).any() for time in times):
            raise ValueError("world: expected steady lights, found one that changes")


def _scaled(block: Block, factor: int) -> Block:
    return tuple(slice(factor * part.start, factor * part.stop) for part in block)
