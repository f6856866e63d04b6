"""Scene `still`: a still life under constant light; no view has a time.

Purpose: the control. The scene is static and the model is ordinary 3D Gaussian Splatting.
"""

from __future__ import annotations

import numpy as np

from datasets.synthetic.shapes import Box, Rectangle, Ring, Sphere
from datasets.synthetic.texture import checker, marble, mottled, plain, sectors, stripes, tiles
from datasets.synthetic.world import Body, Light, Material, World, rest, steady, turn

FLOOR = -0.45


def build(rng: np.random.Generator) -> World:
    red, blue, green = (0.78, 0.22, 0.18), (0.18, 0.38, 0.70), (0.25, 0.55, 0.32)
    sand, white, ink = (0.86, 0.72, 0.48), (0.93, 0.91, 0.86), (0.12, 0.13, 0.18)
    floor = tiles(
        mottled((0.55, 0.42, 0.28), (0.78, 0.62, 0.42), 0.12, rng),
        mottled((0.36, 0.25, 0.16), (0.54, 0.38, 0.25), 0.12, rng),
        0.2,
    )
    # The board leans back; its own z axis is its normal.
    lean = turn("z", 0.9) @ turn("x", np.pi / 2 - 0.25)
    board = checker(mottled(blue, white, 0.1, rng), stripes(plain(sand), plain(red), 0.06, (1, 1, 0)), 0.24)
    bodies = (
        Body(Rectangle((0.80, 0.80)), Material(floor), rest((0, 0, FLOOR))),
        Body(Rectangle((0.50, 0.36)), Material(board), rest((0.28, -0.36, FLOOR + 0.36), lean)),
        Body(Sphere(0.28), Material(marble(ink, white, 0.08, rng), specular=0.4), rest((-0.15, 0.30, FLOOR + 0.28))),
        Body(Sphere(0.16), Material(mottled(red, sand, 0.07, rng), specular=0.4), rest((-0.52, -0.30, FLOOR + 0.16))),
        Body(
            Box((0.18, 0.18, 0.18)),
            Material(checker(plain(green), plain(white), 0.12)),
            rest((0.48, 0.30, FLOOR + 0.18), turn("z", 0.35)),
        ),
        Body(
            Box((0.12, 0.12, 0.12)),
            Material(stripes(plain(blue), plain(white), 0.06, (0.3, 0, 1))),
            rest((0.46, 0.29, FLOOR + 0.48), turn("z", -0.3)),
        ),
        Body(
            Ring(0.14, 0.24, 0.08),
            Material(sectors([plain(red), plain(sand), plain(blue)] * 3), specular=0.3),
            rest((-0.20, -0.12, FLOOR + 0.08)),
        ),
        Body(Ring(0.0, 0.09, 0.30), Material(mottled(green, sand, 0.08, rng)), rest((-0.58, 0.24, FLOOR + 0.30))),
    )
    return World(
        bodies=bodies,
        is_static=True,
        lights=(
            Light((2.2, 1.6, 4.0), 0.35, steady(0.72, 0.68, 0.60)),
            Light((-2.5, -2.0, 3.0), 0.4, steady(0.18, 0.20, 0.24), casts_shadow=False),
        ),
    )
