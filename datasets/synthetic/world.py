"""What a synthetic scene is made of: bodies with a motion and a material, lights, and the sky.

World frame: z up, right-handed. In the scenes in D-NeRF's layout everything lies within [-1.2, 1.2]³ and time runs
from 0 to 1; in the filmed ones time is in seconds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from datasets.synthetic.shapes import Shape, column
from datasets.synthetic.texture import Colour, Texture


@dataclass(frozen=True)
class Pose:
    """From a body's frame to the world: x -> scale · rotation · x + position. Scale 0: not there."""

    position: np.ndarray  # (3,) world units
    rotation: np.ndarray  # (3, 3)
    scale: float = 1.0

    def to_world(self, points: np.ndarray) -> np.ndarray:
        """Points (3, N) of the body's frame in the world."""
        return (self.scale * self.rotation).astype(np.float32) @ points + column(self.position)

    def to_body(self, points: np.ndarray) -> np.ndarray:
        """World points (3, N) in the body's frame. Needs scale > 0."""
        return self.turn_to_body(points - column(self.position))

    def turn_to_body(self, directions: np.ndarray) -> np.ndarray:
        """World directions (3, N) in the body's frame, scaled so that distances along a ray stay the same."""
        return (self.rotation.T / self.scale).astype(np.float32) @ directions


Motion = Callable[[float], Pose]


@dataclass(frozen=True)
class Material:
    """How a surface answers light: diffuse texture, white Blinn-Phong highlight, own glow."""

    texture: Texture
    specular: float = 0.0  # strength of the highlight
    shininess: float = 40.0  # its exponent: larger is smaller and sharper
    glow: Callable[[float], np.ndarray] | None = None  # RGB at a time, added without light; None: none
    is_lit: bool = True  # False: the texture is the colour, whatever the light (a sky)


@dataclass(frozen=True)
class Body:
    shape: Shape
    material: Material
    motion: Motion
    casts_shadow: bool = True
    changes: bool = False  # it moves or glows by time: film.py traces it anew for each frame, and all others once


@dataclass(frozen=True)
class Light:
    """A round area light that faces the origin."""

    position: tuple[float, float, float]
    radius: float  # of its disc, world units; the softness of its shadows
    colour: Callable[[float], np.ndarray]  # RGB at a time
    casts_shadow: bool = True  # False: a fill light, which reaches everywhere it faces


@dataclass(frozen=True)
class World:
    bodies: tuple[Body, ...]
    lights: tuple[Light, ...]
    sky: Colour = (0.32, 0.34, 0.38)  # light from straight above, and …
    ground: Colour = (0.14, 0.13, 0.12)  # … from straight below (hemispheric light, unshadowed)
    is_static: bool = False


def rest(position: tuple[float, float, float], rotation: np.ndarray | None = None) -> Motion:
    """No motion at all."""
    pose = Pose(np.asarray(position, dtype=float), np.eye(3) if rotation is None else rotation)
    return lambda time: pose


def steady(*colour: float) -> Callable[[float], np.ndarray]:
    """A light's colour that does not change."""
    rgb = np.asarray(colour, dtype=float)
    return lambda time: rgb


def turn(axis: str, angle: float) -> np.ndarray:
    """Rotation (3, 3) by `angle` radians about the axis "x", "y" or "z", counter-clockwise seen from its tip."""
    c, s = np.cos(angle), np.sin(angle)
    first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    rotation = np.eye(3)
    rotation[[first, first, second, second], [first, second, first, second]] = c, -s, s, c
    return rotation
