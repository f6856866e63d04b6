"""Scene `wheel`: a spoked wheel that turns one and a half times while it rolls over a tiled disc.

Purpose: tests 4D rotation. Points of the rim move on fast curved paths; a Gaussian needs the space-time terms of its
covariance to follow them. Gaussians without motion need one set per frame.
"""

from __future__ import annotations

import numpy as np

from datasets.synthetic.shapes import Box, Ring, Sphere
from datasets.synthetic.texture import marble, mottled, plain, sectors, stripes, tiles
from datasets.synthetic.world import Body, Light, Material, Motion, Pose, World, rest, steady, turn

TURNS = 1.5
TRAVEL = 0.9  # world units along x
RIM, TYRE = 0.52, 0.66  # inner and outer radius of the rim
SPOKES = 6
FLOOR = -0.70


def build(rng: np.random.Generator) -> World:
    red, cream, teal = (0.80, 0.20, 0.15), (0.95, 0.88, 0.72), (0.10, 0.55, 0.55)
    gold, ink = (0.90, 0.65, 0.15), (0.12, 0.14, 0.25)
    rim = sectors([mottled(*pair, 0.12, rng) for pair in ((red, cream), (teal, cream), (gold, red))] * 2)
    spoke_colours = [red, teal, gold] * (SPOKES // 3)
    floor = tiles(
        mottled((0.38, 0.36, 0.34), (0.62, 0.60, 0.56), 0.1, rng),
        mottled((0.16, 0.24, 0.30), (0.30, 0.42, 0.48), 0.1, rng),
        0.22,
    )

    bodies = [
        Body(Ring(0.0, 1.05, 0.04), Material(floor), rest((0, 0, FLOOR - 0.04))),
        Body(Ring(RIM, TYRE, 0.09), Material(rim, specular=0.25), _rolling()),
        Body(Ring(0.0, 0.16, 0.13), Material(sectors([plain(cream), plain(ink)] * 3), specular=0.3), _rolling()),
    ]
    for index, colour in enumerate(spoke_colours):
        texture = stripes(plain(colour), plain(cream), 0.09, (1, 0, 0))
        bodies.append(
            Body(Box((0.19, 0.045, 0.035)), Material(texture), _rolling(2 * np.pi * (index + 0.25) / SPOKES, 0.34))
        )
    post = marble((0.20, 0.22, 0.30), (0.75, 0.72, 0.66), 0.16, rng)
    for x, y in ((-0.72, 0.62), (0.72, -0.62)):
        bodies.append(Body(Box((0.10, 0.10, 0.28)), Material(post), rest((x, y, FLOOR + 0.28))))
        bodies.append(
            Body(Sphere(0.13), Material(mottled(gold, cream, 0.1, rng), specular=0.4), rest((x, y, FLOOR + 0.69)))
        )
    return World(
        bodies=tuple(bodies),
        lights=(
            Light((2.2, -1.8, 4.0), 0.35, steady(0.72, 0.68, 0.60)),
            Light((-3.0, 2.5, 2.5), 0.4, steady(0.16, 0.19, 0.24), casts_shadow=False),
        ),
    )


def _rolling(angle: float = 0.0, distance: float = 0.0) -> Motion:
    """The motion of a part of the wheel at `distance` from its axle (along y), in the direction `angle` at time 0."""
    upright = turn("x", np.pi / 2)  # a shape's z axis becomes the axle

    def motion(time: float) -> Pose:
        axle = np.array([TRAVEL * (time - 0.5), 0.0, FLOOR + TYRE + 0.01])
        rotation = turn("y", 2 * np.pi * TURNS * time) @ upright @ turn("z", angle)
        return Pose(axle + rotation @ np.array([distance, 0.0, 0.0]), rotation)

    return motion
