"""Scene `street`: a street with houses, signs and trees; cars, and a walker who crosses it; a sky.

Purpose: a driving log with exact depth, flow and masks, seen from a car that drives along +x (drive.py). Metres and
seconds, z up, the road's surface at z = 0. What moves casts no shadow.
"""

from __future__ import annotations

import numpy as np

from datasets.synthetic.shapes import Box, Rectangle, Ring, Shape, Sphere
from datasets.synthetic.texture import Colour, Texture, average, checker, mosaic, mottled, plain, sectors, select
from datasets.synthetic.world import Body, Light, Material, Motion, Pose, World, rest, steady, turn

LENGTH = 130.0  # of the street, metres
ROAD, PAVEMENT = 4.5, 7.5  # half widths
LANE = 2.2  # distance of a lane's middle from the road's
HORIZON, ZENITH, CLOUD = (0.86, 0.91, 0.97), (0.35, 0.56, 0.88), (0.97, 0.97, 0.98)  # colours of the sky


def build(rng: np.random.Generator) -> World:
    bodies = [
        Body(Rectangle((LENGTH, 60.0)), Material(_ground(rng)), rest((0.3 * LENGTH, 0, 0))),
        *_houses(rng),
        *_street_furniture(rng),
        *_car((0.75, 0.12, 0.10), rng, _driving(17.0, -LANE, 8.5)),  # ahead, a little slower than the camera's car
        *_car((0.12, 0.25, 0.60), rng, _driving(52.0, LANE, -9.0)),  # oncoming
        *_car((0.80, 0.78, 0.72), rng, _driving(95.0, LANE, -11.0)),
        *_car((0.20, 0.45, 0.25), rng, _driving(12.0, 6.0, 0.0)),  # parked
        *_walker(rng),
    ]
    return World(
        bodies=tuple(bodies),
        lights=(Light((60.0, -90.0, 150.0), 1.0, steady(0.62, 0.58, 0.50), casts_shadow=False),),
        sky=(0.48, 0.52, 0.58),
        ground=(0.26, 0.25, 0.24),
    )


def sky_color(directions: np.ndarray) -> np.ndarray:
    """(3, …) RGB of directions (3, …): pale at the horizon, blue above, with clouds."""
    x, y, z = directions / np.linalg.norm(directions, axis=0)
    height = np.clip(z, 0, 1) ** np.float32(0.6)
    wide = (slice(None),) + (None,) * x.ndim
    blue = np.array(HORIZON)[wide] * (1 - height) + np.array(ZENITH)[wide] * height
    waves = np.sin(9 * x + 4 * z) + np.sin(7 * y - 3 * x + 1) + np.sin(16 * z + 5 * y + 2)
    cloud = 0.5 * np.clip(waves - 0.6, 0, 1)
    return (blue * (1 - cloud) + np.array(CLOUD)[wide] * cloud).astype(np.float32)


def _ground(rng: np.random.Generator) -> Texture:
    """Asphalt with lane markings, pavements of slabs, grass beyond."""
    asphalt = average(
        mottled((0.24, 0.24, 0.25), (0.40, 0.39, 0.38), 0.7, rng), mosaic((0.26,) * 3, (0.38,) * 3, 0.35, rng)
    )
    slabs = mosaic((0.50, 0.48, 0.45), (0.66, 0.64, 0.60), 0.6, rng)
    grass = mottled((0.18, 0.30, 0.10), (0.38, 0.50, 0.20), 1.2, rng)
    white = plain((0.92, 0.92, 0.90))

    def texture(points: np.ndarray) -> np.ndarray:
        x, y = points[0], np.abs(points[1])
        dashes = (y < 0.09) & (x % 4.0 < 2.0)
        edges = (y > ROAD - 0.35) & (y < ROAD - 0.20)
        kind = np.where(dashes | edges, 3, np.where(y < ROAD, 0, np.where(y < PAVEMENT, 1, 2)))
        return select(kind, (asphalt, slabs, grass, white), points)

    return texture


def _houses(rng: np.random.Generator) -> list[Body]:
    """A row on either side, each with a front of windows, and one at the end of the street."""
    found = [_house((100.0, 0.0), (4.0, 22.0, 7.0), rng)]
    for side in (-1, 1):
        x = -6.0
        while x < 80:
            width, depth, height = rng.uniform(3.5, 6.0), rng.uniform(3.0, 4.5), rng.uniform(2.2, 5.0)
            setback = PAVEMENT + rng.uniform(1.0, 4.0)
            found.append(_house((x + width, side * (setback + depth)), (width, depth, height), rng))
            x += 2 * width + rng.uniform(0.5, 4.0)
    return found


def _house(place: tuple[float, float], half: tuple[float, float, float], rng: np.random.Generator) -> Body:
    blocks = mosaic(_colour(rng, 0.45), _colour(rng, 0.80), 0.4, rng)
    wall = average(blocks, mottled(_colour(rng, 0.5), _colour(rng, 0.8), 1.5, rng))
    window = mosaic((0.08, 0.10, 0.14), (0.30, 0.36, 0.44), 0.5, rng)

    def texture(points: np.ndarray) -> np.ndarray:
        along = np.where(np.abs(points[1]) > half[1] - 0.01, points[0], points[1])
        inside = (along % 2.4 > 0.8) & (along % 2.4 < 1.8) & (points[2] % 2.5 > 0.8) & (points[2] % 2.5 < 2.0)
        return select(np.where(inside & (points[2] < half[2] - 0.3), 1, 0), (wall, window), points)

    return Body(Box(half), Material(texture), rest((*place, half[2])))


def _street_furniture(rng: np.random.Generator) -> list[Body]:
    """Signs and trees along the pavements."""
    found = []
    for index, x in enumerate(np.arange(4.0, 84.0, 11.0)):
        side = 1 if index % 2 else -1
        y = side * (ROAD + 0.7)
        if index % 3 == 0:
            disc = Material(sectors([plain((0.85, 0.10, 0.10)), plain((0.95, 0.95, 0.95))] * 3))
            found += [
                Body(Box((0.06, 0.06, 1.3)), Material(plain((0.55, 0.56, 0.58))), rest((x, y, 1.3))),
                Body(Ring(0.0, 0.45, 0.04), disc, rest((x, y, 2.7), turn("y", np.pi / 2))),
            ]
        else:
            bark, leaves = (0.28, 0.20, 0.13), mottled((0.10, 0.22, 0.06), (0.34, 0.50, 0.18), 0.5, rng)
            found += [
                Body(Ring(0.0, 0.16, 1.2), Material(mottled(bark, (0.42, 0.32, 0.22), 0.3, rng)), rest((x, y, 1.2))),
                Body(Sphere(rng.uniform(1.0, 1.5)), Material(leaves), rest((x, y, 3.3))),
            ]
    return found


def _car(colour: Colour, rng: np.random.Generator, motion: Motion) -> list[Body]:
    """A body and a cabin, with motifs that show its motion."""
    red, green, blue = (min(1.0, 0.55 * c + 0.40) for c in colour)
    paint = average(plain(colour), mosaic(colour, (red, green, blue), 0.3, rng))
    glass = checker(plain((0.10, 0.12, 0.16)), plain((0.30, 0.35, 0.42)), 0.6)

    def part(shape: Box, texture: Texture, offset: tuple[float, float, float]) -> Body:
        return Body(shape, Material(texture), _attached(motion, offset), casts_shadow=False, changes=True)

    return [part(Box((2.1, 0.9, 0.45)), paint, (0.0, 0.0, 0.70)), part(Box((1.1, 0.8, 0.32)), glass, (-0.2, 0.0, 1.47))]


def _walker(rng: np.random.Generator) -> list[Body]:
    """Crosses the road from the right, ahead of the car."""

    def motion(time: float) -> Pose:
        return Pose(np.array([36.0, -6.5 + 1.6 * time, 0.0]), np.eye(3))

    coat = mosaic((0.75, 0.45, 0.10), (0.95, 0.80, 0.35), 0.2, rng)
    parts: list[tuple[Shape, Texture, tuple[float, float, float]]] = [
        (Box((0.18, 0.26, 0.42)), coat, (0.0, 0.0, 1.15)),
        (Box((0.13, 0.20, 0.38)), plain((0.12, 0.13, 0.25)), (0.0, 0.0, 0.38)),
        (Sphere(0.16), mottled((0.60, 0.42, 0.32), (0.85, 0.68, 0.55), 0.2, rng), (0.0, 0.0, 1.72)),
    ]
    return [
        Body(shape, Material(texture), _attached(motion, offset), casts_shadow=False, changes=True)
        for shape, texture, offset in parts
    ]


def _driving(start: float, lane: float, speed: float) -> Motion:
    """Along the x axis. start: x at time 0, metres; lane: y; speed: metres a second along +x."""
    rotation = np.eye(3) if speed >= 0 else turn("z", np.pi)
    return lambda time: Pose(np.array([start + speed * time, lane, 0.0]), rotation)


def _attached(motion: Motion, offset: tuple[float, float, float]) -> Motion:
    """The motion of a part at `offset` in the frame of what it is part of."""

    def moved(time: float) -> Pose:
        pose = motion(time)
        return Pose(pose.position + pose.rotation @ np.array(offset), pose.rotation)

    return moved


def _colour(rng: np.random.Generator, brightness: float) -> Colour:
    red, green, blue = np.clip(brightness * rng.uniform(0.75, 1.15, 3), 0, 1)
    return float(red), float(green), float(blue)
