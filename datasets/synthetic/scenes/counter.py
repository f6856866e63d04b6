"""Scene `counter`: a kitchen counter in front of a window, filmed by a camera rig.

Purpose: a substitute for the Plenoptic Video data set. Static objects are richly textured for structure from motion; a
box tumbles, a ball swings, a roll slides; a flame, a bulb and a screen flicker; behind the window is a distant
landscape with almost no parallax.

World frame: z up, the cameras near (0, -3, 0.6) look at the origin, the counter's top is at TOP. Times in seconds.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from datasets.synthetic.shapes import Box, Dome, Rectangle, Ring, Sphere
from datasets.synthetic.texture import (
    Colour,
    Texture,
    average,
    checker,
    marble,
    mosaic,
    mottled,
    plain,
    sectors,
    stripes,
)
from datasets.synthetic.world import Body, Light, Material, Motion, Pose, World, rest, steady, turn

TOP = -0.42  # height of the counter
FLOOR = -1.7
WALL = 2.0  # y of the wall behind the counter
WINDOW = (-1.95, 0.12, 1.35, 1.75)  # min x, min z, max x, max z
CANDLE, LAMP, SCREEN = (-0.95, -0.32), (1.50, -0.02), (0.66, 0.28)  # x and y of the flickering objects' stands
FAR = 300.0  # radius of the landscape: its parallax over the rig is one pixel at 320 pixels' width

WHITE, INK, SAND = (0.95, 0.93, 0.88), (0.08, 0.08, 0.10), (0.86, 0.74, 0.55)
RED, BLUE, GREEN, BROWN = (0.62, 0.16, 0.12), (0.14, 0.28, 0.52), (0.16, 0.36, 0.18), (0.34, 0.20, 0.12)


def build(rng: np.random.Generator) -> World:
    still_rng, changing_rng = rng.spawn(2)
    return World(
        bodies=(*_room(still_rng), *_things(still_rng), *_moving(changing_rng), *_flickering(changing_rng)),
        lights=(
            Light((-1.3, -2.2, 2.8), 0.25, steady(0.70, 0.67, 0.60)),
            Light((2.5, -2.5, 1.5), 0.4, steady(0.20, 0.22, 0.26), casts_shadow=False),
        ),
        sky=(0.34, 0.35, 0.38),
        ground=(0.18, 0.16, 0.15),
    )


# --- static bodies ----------------------------------------------------------------------------------------------------


def _room(rng: np.random.Generator) -> list[Body]:
    """Landscape, wall with window and pictures, floor, counter. Only the window's bars cast shadows."""
    tiling = average(
        mosaic((0.45, 0.43, 0.40), (0.92, 0.88, 0.80), 0.30, rng),
        mottled((0.45, 0.42, 0.38), (0.98, 0.94, 0.88), 0.09, rng),
    )
    planks = average(
        stripes(mottled(BROWN, SAND, 0.08, rng), mottled((0.22, 0.13, 0.08), SAND, 0.12, rng), 0.25, (1, 0, 0)),
        mosaic((0.40, 0.28, 0.18), (0.70, 0.56, 0.40), 0.07, rng),
    )
    granite = average(
        mosaic((0.15, 0.15, 0.16), (0.80, 0.78, 0.74), 0.06, rng),
        marble((0.30, 0.29, 0.29), (0.88, 0.85, 0.80), 0.14, rng),
    )
    left, low, right, high = WINDOW
    upright = turn("x", np.pi / 2)  # a rectangle's y becomes the world's z
    bodies = [
        Body(Dome(FAR), Material(_landscape(rng), is_lit=False), rest((0, 0, 0)), casts_shadow=False),
        Body(Rectangle((6.0, 3.0), WINDOW), Material(tiling), rest((0, WALL, 0), upright), casts_shadow=False),
        Body(Rectangle((6.0, 6.0)), Material(planks), rest((0, -1.0, FLOOR)), casts_shadow=False),
        Body(Box((2.6, 0.75, 0.05)), Material(granite, specular=0.15), rest((0, 0, TOP - 0.05)), casts_shadow=False),
        Body(Box((2.5, 0.68, 0.6)), Material(planks), rest((0, 0, TOP - 0.7)), casts_shadow=False),
    ]
    wood = Material(average(stripes(plain(SAND), plain(BROWN), 0.03, (1, 0.3, 1)), mottled(BROWN, SAND, 0.04, rng)))
    x, z, half_x, half_z = (left + right) / 2, (low + high) / 2, (right - left) / 2, (high - low) / 2
    for place, half in (
        ((left, z), (0.05, half_z)),
        ((right, z), (0.05, half_z)),
        ((x, high), (half_x + 0.05, 0.05)),
        ((x, z), (0.025, half_z)),
        ((x, low), (half_x + 0.15, 0.06)),
    ):
        bodies.append(Body(Box((half[0], 0.06, half[1])), wood, rest((place[0], WALL - 0.05, place[1]))))
    for place, half, colours, size in (
        ((2.15, 0.95), (0.38, 0.50), (BLUE, WHITE), 0.09),
        ((3.1, 1.0), (0.35, 0.35), (RED, SAND), 0.07),
        ((-2.65, 0.95), (0.40, 0.55), (GREEN, WHITE), 0.08),
    ):
        print_ = average(mosaic(*colours, size, rng), mosaic(INK, WHITE, 0.4 * size, rng))
        bodies.append(Body(Box((half[0], 0.02, half[1])), Material(print_), rest((place[0], WALL - 0.03, place[1]))))
    return bodies


def _things(rng: np.random.Generator) -> list[Body]:
    """Objects on the counter."""

    def paper(dark: Colour, light: Colour, size: float) -> Material:
        return Material(average(mosaic(dark, light, size, rng), mosaic(INK, WHITE, 0.4 * size, rng)))

    def glaze(dark: Colour, light: Colour, size: float) -> Material:
        return Material(average(marble(dark, light, size, rng), mosaic(dark, light, 0.6 * size, rng)), specular=0.2)

    def on_top(
        shape: Box | Ring | Sphere,
        material: Material,
        x: float,
        y: float,
        height: float,
        angle: float = 0.0,
        above: float = 0.0,
    ) -> Body:
        """height: of the shape's centre over its support, which is `above` over the counter."""
        return Body(shape, material, rest((x, y, TOP + above + height), turn("z", angle)))

    lean = turn("z", 0.2) @ turn("x", -0.25)
    board = checker(mosaic(INK, SAND, 0.05, rng), mosaic(BROWN, WHITE, 0.04, rng), 0.15)
    bowl = sectors([mosaic(BLUE, WHITE, 0.05, rng), mosaic(INK, WHITE, 0.04, rng)] * 4)
    tray = checker(mosaic(BROWN, SAND, 0.04, rng), mosaic(INK, WHITE, 0.04, rng), 0.12)
    return [
        on_top(Box((0.22, 0.09, 0.34)), paper(RED, SAND, 0.09), -1.08, 0.36, 0.34, 0.35),
        on_top(Box((0.17, 0.08, 0.26)), paper(BLUE, WHITE, 0.08), -0.64, 0.47, 0.26, -0.2),
        on_top(Sphere(0.24), glaze(INK, WHITE, 0.10), -0.22, 0.36, 0.24),
        on_top(Ring(0.0, 0.06, 0.04), glaze(BROWN, SAND, 0.05), -0.22, 0.36, 0.02, above=0.48),
        Body(Box((0.34, 0.02, 0.25)), Material(board), rest((0.20, 0.62, TOP + 0.24), lean)),
        on_top(Ring(0.0, 0.11, 0.20), glaze(GREEN, WHITE, 0.07), 1.05, 0.50, 0.20),
        on_top(Ring(0.0, 0.13, 0.15), glaze(RED, WHITE, 0.07), 1.33, 0.40, 0.15),
        on_top(Ring(0.0, 0.10, 0.25), glaze(INK, SAND, 0.06), 1.62, 0.52, 0.25),
        on_top(Ring(0.17, 0.24, 0.10), Material(bowl), 1.05, -0.15, 0.10),
        on_top(Sphere(0.13), glaze((0.55, 0.30, 0.06), SAND, 0.06), 1.05, -0.15, 0.17),
        on_top(Box((0.28, 0.20, 0.05)), paper(GREEN, SAND, 0.08), -1.40, -0.05, 0.05, 0.25),
        on_top(Box((0.25, 0.18, 0.045)), paper(INK, WHITE, 0.08), -1.38, -0.04, 0.045, -0.1, above=0.10),
        on_top(Box((0.22, 0.16, 0.04)), paper(RED, WHITE, 0.07), -1.41, -0.05, 0.04, 0.5, above=0.19),
        on_top(Box((0.32, 0.20, 0.025)), Material(tray), -0.42, -0.38, 0.025, 0.15),
        on_top(Sphere(0.11), glaze(GREEN, SAND, 0.05), -0.29, -0.34, 0.11, above=0.05),
        on_top(Sphere(0.09), glaze(RED, SAND, 0.05), -0.52, -0.42, 0.09, above=0.05),
        on_top(Ring(0.0, 0.07, 0.13), glaze(BROWN, WHITE, 0.05), CANDLE[0], CANDLE[1], 0.13),
        on_top(Ring(0.0, 0.09, 0.02), glaze(INK, SAND, 0.05), LAMP[0], LAMP[1], 0.02),
        on_top(Ring(0.0, 0.025, 0.28), glaze(INK, SAND, 0.05), LAMP[0], LAMP[1], 0.28),
        on_top(Box((0.27, 0.02, 0.19)), glaze(INK, SAND, 0.06), SCREEN[0], SCREEN[1], 0.21),
        on_top(Box((0.12, 0.09, 0.01)), glaze(INK, SAND, 0.06), SCREEN[0], SCREEN[1], 0.01),
    ]


def _landscape(rng: np.random.Generator) -> Texture:
    """Clouds above hills: a colour for each direction, on a sphere of radius FAR."""
    skyline = _skyline(rng)
    sky = average(
        mottled((0.25, 0.45, 0.72), (0.98, 0.98, 0.98), 26.0, rng),
        mottled((0.45, 0.60, 0.80), (1.00, 0.98, 0.96), 9.0, rng),
    )
    land = average(
        mottled((0.10, 0.20, 0.08), (0.62, 0.62, 0.36), 14.0, rng),
        mosaic((0.08, 0.12, 0.06), (0.80, 0.76, 0.56), 7.0, rng),
    )

    def texture(points: np.ndarray) -> np.ndarray:
        return np.where(points[2] > skyline(points), sky(points), land(points))

    return texture


def _skyline(rng: np.random.Generator) -> Callable[[np.ndarray], np.ndarray]:
    """Height (N,) of the hills in the direction of points (3, N)."""
    cycles, heights, phases = np.array([9, 17, 31, 67]), np.array([5.0, 4.0, 2.5, 1.2]), rng.uniform(0, 2 * np.pi, 4)

    def height(points: np.ndarray) -> np.ndarray:
        azimuth = np.arctan2(points[1], points[0])
        return np.float32(14.0) + sum(
            np.float32(size) * np.sin(np.float32(n) * azimuth + np.float32(phase))
            for n, size, phase in zip(cycles, heights, phases)
        )

    return height


# --- changing bodies, which cast no shadow (film.py) ------------------------------------------------------------------


def _moving(rng: np.random.Generator) -> list[Body]:
    box = checker(mosaic(RED, WHITE, 0.04, rng), mosaic(INK, SAND, 0.05, rng), 0.12)
    ball = sectors([mosaic(BLUE, WHITE, 0.05, rng), mottled(SAND, WHITE, 0.06, rng)] * 3)
    roll = stripes(mosaic(GREEN, WHITE, 0.04, rng), mosaic(INK, SAND, 0.03, rng), 0.07, (0, 0.5, 1))
    swinging = _swinging(rng)
    # The thread in pieces: each is traced in its own screen block, and one long piece would have a large one.
    thread = [
        _changing_body(Box((0.012, 0.012, 0.1)), Material(plain(BROWN)), swinging(0.1 + 0.2 * piece))
        for piece in range(5)
    ]
    return [
        _changing_body(Box((0.17, 0.17, 0.17)), Material(box), _tumbling(rng)),
        _changing_body(Sphere(0.19), Material(ball, specular=0.3), swinging(1.15)),
        _changing_body(Ring(0.0, 0.11, 0.16), Material(roll), _sliding(rng)),
        *thread,
    ]


def _changing_body(shape: Box | Ring | Sphere, material: Material, motion: Motion) -> Body:
    return Body(shape, material, motion, casts_shadow=False, changes=True)


def _tumbling(rng: np.random.Generator) -> Motion:
    """Circles above the counter while it rotates about two axes."""
    phase, spin = rng.uniform(0, 2 * np.pi, 2), rng.uniform(2.5, 3.5, 2)  # radians; radians a second

    def motion(time: float) -> Pose:
        angle = 2 * np.pi * time / 3.1 + phase[0]
        place = np.array([-0.45 + 0.30 * np.cos(angle), -0.10 + 0.15 * np.sin(angle), 0.22 + 0.08 * np.sin(2 * angle)])
        return Pose(place, turn("z", spin[0] * time + phase[1]) @ turn("x", spin[1] * time))

    return motion


def _swinging(rng: np.random.Generator) -> Callable[[float], Motion]:
    """A pendulum in front of the window: the motion of a body at a distance below its pivot."""
    pivot, phase = np.array([0.45, 0.05, 1.25]), rng.uniform(0, 2 * np.pi)

    def at(distance: float) -> Motion:
        def motion(time: float) -> Pose:
            rotation = turn("y", 0.45 * np.sin(2 * np.pi * time / 1.9 + phase))
            return Pose(pivot + rotation @ np.array([0.0, 0.0, -distance]), rotation)

        return motion

    return at


def _sliding(rng: np.random.Generator) -> Motion:
    """Oscillates along the counter's front edge, upright, with a small rotation."""
    phase = rng.uniform(0, 2 * np.pi)

    def motion(time: float) -> Pose:
        way = np.sin(2 * np.pi * time / 4.3 + phase)
        return Pose(np.array([0.30 + 0.42 * way, -0.54, TOP + 0.16]), turn("z", 1.5 * way))

    return motion


def _flickering(rng: np.random.Generator) -> list[Body]:
    flame, bulb, red, green, blue = (_flicker(rng) for _ in range(5))
    screen = mosaic((0.05, 0.06, 0.08), (0.45, 0.50, 0.55), 0.04, rng)
    dark = plain((0.05, 0.04, 0.03))

    def burning(time: float) -> Pose:
        return Pose(np.array([*CANDLE, TOP + 0.35]), np.eye(3), scale=0.7 + 0.3 * flame(time))

    def glow(colour: Colour, power: Callable[[float], float]) -> Material:
        return Material(dark, glow=lambda time: np.asarray(colour) * (0.2 + 0.8 * power(time)))

    shown = Material(screen, glow=lambda time: 0.6 * np.array([red(time), green(time), blue(time)]))
    return [
        _changing_body(Sphere(0.10), glow((1.0, 0.40, 0.05), flame), burning),
        _changing_body(Sphere(0.14), glow((1.0, 0.90, 0.60), bulb), rest((*LAMP, TOP + 0.68))),
        _changing_body(Box((0.24, 0.01, 0.16)), shown, rest((SCREEN[0], SCREEN[1] - 0.025, TOP + 0.21))),
    ]


def _flicker(rng: np.random.Generator) -> Callable[[float], float]:
    """An irregular brightness in [0, 1]: waves of different frequencies, one of them above 10 Hz."""
    cycles = np.array([0.6, 1.7, 4.3, 11.0]) * rng.uniform(1.0, 1.2, 4)  # a second; 30 frames show up to 15
    phases = rng.uniform(0, 2 * np.pi, 4)
    weights = np.array([0.25, 0.25, 0.2, 0.3])
    return lambda time: float(0.5 + 0.5 * weights @ np.sin(2 * np.pi * cycles * time + phases))
