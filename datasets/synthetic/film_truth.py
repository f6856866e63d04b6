"""Ground truth of a filmed camera: depth, optical flow and the pixels that move, in every frame.

The camera stands still, so only changing bodies (`Body.changes`) differ between frames; they are traced with one ray a
pixel, through its centre, against the depth of the others. As in film.py this equals a full trace.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np

from datasets.synthetic.film import depth_of
from datasets.synthetic.shade import place
from datasets.synthetic.shapes import column
from datasets.synthetic.trace import NOTHING, first_hits, flow_of, rays, screen_block
from datasets.synthetic.world import World, moves
from rasterizer.camera import Camera

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
