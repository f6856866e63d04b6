"""Shading of ray hits: hemispheric light, area lights with soft shadows, Blinn-Phong highlights.

    colour = texture · (hemisphere(n) + Σ_lights visibility · colour · max(0, n·l))
           + Σ_lights visibility · colour · specular · max(0, n·h)^shininess + glow

or the texture alone, for an unlit material.

Soft shadows without noise: the light's disc has as many sample points as a pixel has rays, and ray k of every pixel
tests sample point k. The average over a pixel is the visible part of the disc. It is the same from every camera, which
random shadow rays would not give.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from datasets.synthetic.shapes import column, dot, norm
from datasets.synthetic.world import Body, Light, Pose, World

# Offset of shadow rays from the surface, against self-shadowing by float32 rounding (4e-7 at distance 4).
SHADOW_BIAS = np.float32(1e-4)
GOLDEN_ANGLE = np.pi * (3 - 5**0.5)


@dataclass(frozen=True)
class Placed:
    """A body with its pose at one time."""

    body: Body
    pose: Pose

    @cached_property
    def radius(self) -> float:
        """Of its bounding sphere, world units."""
        return self.pose.scale * self.body.shape.radius


def place(world: World, time: float) -> list[Placed]:
    """The bodies present at a time, with their poses."""
    placed = [Placed(body, body.motion(time)) for body in world.bodies]
    return [item for item in placed if item.pose.scale > 0]


def shade(
    receiver: Placed,
    points: np.ndarray,
    local: np.ndarray,
    toward_eye: np.ndarray,
    sample: np.ndarray,
    samples: int,
    placed: list[Placed],
    world: World,
    time: float,
) -> np.ndarray:
    """Colour (3, N) in [0, 1] of N points of one body.

    points, local: (3, N) in world and body coordinates. toward_eye: (3, N) unit vectors. sample: (N,) index of the ray
    among the `samples` rays of its pixel.
    """
    material = receiver.body.material
    if not material.is_lit:
        return np.clip(material.texture(local), 0, 1)
    normal = receiver.pose.rotation.astype(np.float32) @ receiver.body.shape.normal(local)
    normal = np.copysign(1, dot(normal, toward_eye)) * normal  # towards the camera: a rectangle has two sides

    up = 0.5 + 0.5 * normal[2]
    diffuse = up * column(world.sky) + (1 - up) * column(world.ground)
    highlight = np.zeros_like(points)
    for light in world.lights:
        incoming = column(light.colour(time))
        toward_light = sample_disc(light, samples).take(sample, axis=1) - points
        segment = toward_light
        toward_light = toward_light / norm(toward_light)
        facing = np.maximum(dot(normal, toward_light), 0)
        if light.casts_shadow:
            facing *= unoccluded(points + SHADOW_BIAS * normal, segment, facing > 0, receiver, light, placed)
        diffuse += facing * incoming
        if material.specular > 0:
            lit = np.flatnonzero(facing)
            half = (toward_light + toward_eye).take(lit, axis=1)
            shine = np.maximum(dot(normal.take(lit, axis=1), half) / norm(half), 0) ** np.float32(material.shininess)
            highlight[:, lit] += material.specular * shine * incoming
    colour = material.texture(local) * diffuse + highlight
    if material.glow is not None:
        colour += column(material.glow(time))
    return np.clip(colour, 0, 1)


def unoccluded(
    start: np.ndarray, segment: np.ndarray, tested: np.ndarray, receiver: Placed, light: Light, placed: list[Placed]
) -> np.ndarray:
    """(N,) bool: the segments from start (3, N) to start + segment that hit no body. False unless `tested`."""
    clear = tested.copy()
    squared = dot(segment, segment)
    for occluder in _possible_occluders(placed, receiver, light):
        # Exact intersection only for segments through the occluder's bounding sphere.
        offset = column(occluder.pose.position) - start
        along = np.clip(dot(offset, segment) / squared, 0, 1)
        offset -= along * segment
        near = np.flatnonzero(clear & (dot(offset, offset) <= occluder.radius**2))
        if near.size:
            distance = occluder.body.shape.intersect(
                occluder.pose.to_body(start.take(near, axis=1)), occluder.pose.turn_to_body(segment.take(near, axis=1))
            )
            clear[near[(distance > 0) & (distance < 1)]] = False  # 1 is the light itself
    return clear


@lru_cache
def sample_disc(light: Light, count: int) -> np.ndarray:
    """`count` points (3, count) on the light's disc: a sunflower spiral (Vogel 1979), even in every direction.

    A single sample is the centre.
    """
    centre = np.asarray(light.position, dtype=float)
    axis = centre / np.linalg.norm(centre)
    side = np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    index = np.arange(count)
    radius = light.radius * np.sqrt((index + 0.5) / count) * (count > 1)
    angle = GOLDEN_ANGLE * index
    spread = np.outer(side, radius * np.cos(angle)) + np.outer(np.cross(axis, side), radius * np.sin(angle))
    return (centre[:, None] + spread).astype(np.float32)


def _possible_occluders(placed: list[Placed], receiver: Placed, light: Light) -> list[Placed]:
    """Bodies whose bounding sphere meets the tube of all segments from the receiver to the light."""
    casting = [item for item in placed if item.body.casts_shadow]
    if not casting:
        return []
    radius = np.array([item.radius for item in casting])
    offset = np.array([item.pose.position for item in casting]) - receiver.pose.position
    segment = np.asarray(light.position) - receiver.pose.position
    along = np.clip(offset @ segment / max(segment @ segment, 1e-12), 0, 1)
    distance = np.linalg.norm(offset - along[:, None] * segment, axis=1)
    meets = distance <= max(receiver.radius, light.radius) + radius
    return [
        item
        for item, it_meets in zip(casting, meets)
        if (it_meets if item is not receiver else not receiver.body.shape.is_convex)
    ]
