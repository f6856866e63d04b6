"""Scene `burst`: balls, cubes and rings thrown from a basin one after the other, each visible for a short time.

Purpose: tests densification in time. The initial Gaussians live longer than the objects and must be split in time as
well as in space.
"""

from __future__ import annotations

import numpy as np

from datasets.synthetic.shapes import Box, Ring, Shape, Sphere
from datasets.synthetic.texture import Texture, checker, marble, mottled, plain, sectors, stripes, tiles
from datasets.synthetic.world import Body, Light, Material, Motion, Pose, World, rest, steady, turn

COUNT = 16
LIFETIME = (0.16, 0.26)  # of the duration; three or four objects are in the air at any time
SWELL = 0.02  # time to grow to full size, and to shrink to nothing
FLOOR = -0.80
MOUTH = np.array([0.0, 0.0, FLOOR + 0.30])  # start of all trajectories


def build(rng: np.random.Generator) -> World:
    floor = tiles(
        mottled((0.42, 0.38, 0.34), (0.66, 0.62, 0.56), 0.1, rng),
        mottled((0.30, 0.20, 0.18), (0.48, 0.34, 0.30), 0.1, rng),
        0.24,
    )
    basin = sectors([mottled((0.20, 0.32, 0.45), (0.50, 0.66, 0.78), 0.1, rng), plain((0.85, 0.82, 0.75))] * 6)
    bodies = [
        Body(Ring(0.0, 1.05, 0.04), Material(floor), rest((0, 0, FLOOR - 0.04))),
        Body(Ring(0.24, 0.34, 0.13), Material(basin, specular=0.3), rest((0, 0, FLOOR + 0.13))),
    ]
    for index in range(COUNT):
        # Start times evenly spaced from just before the beginning to just before the end.
        birth = -0.08 + (index + 0.3 * rng.random()) * 1.0 / COUNT
        bodies.append(Body(*_thing(index, rng), _flight(birth, rng, 2.4 * index)))
    return World(
        bodies=tuple(bodies),
        lights=(
            Light((2.0, 1.6, 4.2), 0.35, steady(0.74, 0.70, 0.62)),
            Light((-2.5, -2.5, 2.5), 0.4, steady(0.17, 0.20, 0.26), casts_shadow=False),
        ),
    )


def _thing(index: int, rng: np.random.Generator) -> tuple[Shape, Material]:
    colours = ((0.90, 0.25, 0.18), (0.95, 0.70, 0.15), (0.20, 0.60, 0.85), (0.35, 0.72, 0.35), (0.72, 0.35, 0.75))
    vivid, pale = colours[index % len(colours)], (0.95, 0.92, 0.85)
    textures: tuple[Texture, ...] = (
        checker(plain(vivid), plain(pale), 0.11),
        marble(vivid, pale, 0.08, rng),
        stripes(plain(vivid), plain(pale), 0.07, (1, 0.5, 0.3)),
        mottled(vivid, pale, 0.08, rng),
    )
    shapes: tuple[Shape, ...] = (Sphere(0.17), Box((0.13, 0.13, 0.13)), Ring(0.09, 0.18, 0.06))
    return shapes[index % len(shapes)], Material(textures[index % len(textures)], specular=0.3)


def _flight(birth: float, rng: np.random.Generator, heading: float) -> Motion:
    """Up from the mouth along a parabola in the direction `heading`, tumbling; absent outside its lifetime."""
    lifetime = rng.uniform(*LIFETIME)
    reach = rng.uniform(0.50, 0.90)  # horizontal way over the lifetime, world units
    peak = rng.uniform(0.75, 1.10)  # above the mouth
    spin = rng.uniform(0.3, 0.8) * 2 * np.pi
    away = reach * np.array([np.cos(heading), np.sin(heading), 0.0])

    def motion(time: float) -> Pose:
        age = (time - birth) / lifetime
        left = min(time - birth, birth + lifetime - time)  # to the nearer end of its lifetime
        height = 4 * peak * 0.85 * age * (1 - 0.85 * age)  # it vanishes while falling
        rotation = turn("z", heading) @ turn("y", spin * age)
        return Pose(MOUTH + age * away + [0.0, 0.0, height], rotation, scale=float(np.clip(left / SWELL, 0, 1)))

    return motion
