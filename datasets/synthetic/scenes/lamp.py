"""Scene `lamp`: a still life with glossy objects under coloured lamps of varying power.

Purpose: tests 4D spherindrical harmonics. Nothing moves, but colours change with time (one or two cycles over the
duration, each lamp in its own phase) and highlights with the direction. Without 4DSH a changing colour needs several
Gaussians, one after the other.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from datasets.synthetic.shapes import Box, Ring, Sphere
from datasets.synthetic.texture import checker, marble, mottled, plain, sectors, stripes, tiles
from datasets.synthetic.world import Body, Light, Material, World, rest, steady, turn

FLOOR = -0.6
# Colour at full power, place, cycles over the duration and phase (fraction of a cycle) of each lamp.
LAMPS = (
    ((1.00, 0.30, 0.16), (0.85, 0.55, 0.62), 1, 0.0),
    ((0.18, 0.52, 1.00), (-0.90, 0.30, 0.70), 1, 0.45),
    ((0.42, 0.95, 0.30), (0.10, -0.95, 0.56), 2, 0.2),
)


def build(rng: np.random.Generator) -> World:
    white, grey, ink = (0.92, 0.90, 0.86), (0.55, 0.54, 0.52), (0.10, 0.11, 0.14)
    floor = tiles(
        mottled((0.50, 0.48, 0.46), (0.78, 0.76, 0.72), 0.12, rng),
        mottled((0.22, 0.21, 0.22), (0.40, 0.38, 0.38), 0.12, rng),
        0.25,
    )
    glossy = partial(Material, specular=0.7, shininess=30.0)
    things = [
        Body(Ring(0.0, 1.10, 0.04), Material(floor, specular=0.15, shininess=20.0), rest((0, 0, FLOOR - 0.04))),
        Body(Sphere(0.34), glossy(marble(ink, white, 0.09, rng)), rest((-0.05, 0.10, FLOOR + 0.34))),
        Body(Sphere(0.20), glossy(plain((0.75, 0.72, 0.70))), rest((0.45, -0.28, FLOOR + 0.20))),
        Body(Sphere(0.15), glossy(checker(plain(white), plain(ink), 0.1)), rest((-0.42, -0.42, FLOOR + 0.15))),
        Body(
            Box((0.17, 0.17, 0.17)),
            glossy(mottled(grey, white, 0.09, rng)),
            rest((0.50, 0.38, FLOOR + 0.17), turn("z", 0.5)),
        ),
        Body(
            Box((0.12, 0.20, 0.32)),
            Material(stripes(plain(white), plain(grey), 0.08, (0, 0.4, 1))),
            rest((-0.62, 0.28, FLOOR + 0.32), turn("z", -0.4)),
        ),
        Body(
            Ring(0.13, 0.24, 0.07), glossy(sectors([plain(white), plain(grey)] * 5)), rest((0.02, -0.56, FLOOR + 0.07))
        ),
    ]
    lights = [Light((1.5, -2.0, 4.5), 0.3, steady(0.22, 0.22, 0.22), casts_shadow=False)]
    stem = Material(plain((0.35, 0.34, 0.33)), specular=0.4)
    for colour, place, cycles, phase in LAMPS:
        power = _pulse(colour, cycles, phase)
        x, y, z = place
        height = 0.5 * (z - FLOOR)
        lights.append(Light(place, 0.08, power))
        things += [
            Body(Sphere(0.08), Material(plain((0.05, 0.05, 0.05)), glow=power), rest(place), casts_shadow=False),
            Body(Box((0.02, 0.02, height)), stem, rest((x, y, FLOOR + height)), casts_shadow=False),
        ]
    return World(bodies=tuple(things), lights=tuple(lights), sky=(0.16, 0.16, 0.18), ground=(0.07, 0.07, 0.07))


def _pulse(colour: tuple[float, float, float], cycles: int, phase: float) -> Callable[[float], np.ndarray]:
    """A lamp's colour, whose power varies between 6 % and 100 % in `cycles` cycles over the duration."""
    full = np.asarray(colour)
    return lambda time: full * (0.53 + 0.47 * np.cos(2 * np.pi * (cycles * time - phase)))
