"""Components of a synthetic world: bodies with shape, material and motion; lights; hemispheric ambient light.

World frame: z up, right-handed. Photographed scenes lie within [-1.2, 1.2]³ and times in [0, 1]; in filmed scenes time
is in seconds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from datasets.synthetic.shapes import Shape, column
from datasets.synthetic.texture import Colour, Texture


@dataclass(frozen=True)
class Pose:
    """From body to world coordinates: x -> scale · rotation · x + position. Scale 0: the body is absent."""

    position: np.ndarray  # (3,) world units
    rotation: np.ndarray  # (3, 3)
    scale: float = 1.0

    def to_world(self, points: np.ndarray) -> np.ndarray:
        """Points (3, N), body -> world."""
        return (self.scale * self.rotation).astype(np.float32) @ points + column(self.position)

    def to_body(self, points: np.ndarray) -> np.ndarray:
        """Points (3, N), world -> body. Needs scale > 0."""
        return self.turn_to_body(points - column(self.position))

    def turn_to_body(self, directions: np.ndarray) -> np.ndarray:
        """Directions (3, N), world -> body, scaled so that distances along a ray stay the same."""
        return (self.rotation.T / self.scale).astype(np.float32) @ directions


Motion = Callable[[float], Pose]


@dataclass(frozen=True)
class Material:
    """Diffuse texture, white Blinn-Phong highlight, emission."""

    texture: Texture
    specular: float = 0.0  # strength of the highlight
    shininess: float = 40.0  # its exponent: larger is smaller and sharper
    glow: Callable[[float], np.ndarray] | None = None  # emitted RGB at a time; None: no emission
    is_lit: bool = True  # False: the colour is the texture alone (a sky)


@dataclass(frozen=True)
class Body:
    shape: Shape
    material: Material
    motion: Motion
    casts_shadow: bool = True
    changes: bool = False  # with time, in pose or emission: film.py traces it in each frame, other bodies only once


@dataclass(frozen=True)
class Light:
    """A disc-shaped area light that faces the origin."""

    position: tuple[float, float, float]
    radius: float  # of its disc, world units; sets the width of penumbras
    colour: Callable[[float], np.ndarray]  # RGB at a time
    casts_shadow: bool = True  # False: a fill light without shadows


@dataclass(frozen=True)
class World:
    bodies: tuple[Body, ...]
    lights: tuple[Light, ...]
    sky: Colour = (0.32, 0.34, 0.38)  # ambient light from above
    ground: Colour = (0.14, 0.13, 0.12)  # ambient light from below
    is_static: bool = False


def moves(motion: Motion, times: Sequence[float] | np.ndarray) -> bool:
    """Whether a body changes its pose between any two of `times`: it moves, turns, grows, appears or vanishes."""
    first, *others = (motion(time) for time in times)
    return any(
        pose.scale != first.scale or (pose.position != first.position).any() or (pose.rotation != first.rotation).any()
        for pose in others
    )


def rest(position: tuple[float, float, float], rotation: np.ndarray | None = None) -> Motion:
    """A constant pose."""
    pose = Pose(np.asarray(position, dtype=float), np.eye(3) if rotation is None else rotation)
    return lambda time: pose


def steady(*colour: float) -> Callable[[float], np.ndarray]:
    """A constant colour of a light."""
    rgb = np.asarray(colour, dtype=float)
    return lambda time: rgb


def turn(axis: str, angle: float) -> np.ndarray:
    """Rotation (3, 3) by `angle` radians about the axis "x", "y" or "z", counter-clockwise seen from its tip."""
    c, s = np.cos(angle), np.sin(angle)
    first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    rotation = np.eye(3)
    rotation[[first, first, second, second], [first, second, first, second]] = c, -s, s, c
    return rotation
