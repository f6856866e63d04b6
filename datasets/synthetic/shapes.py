"""Shapes of the ray tracer, each in its own frame and centred at the origin: ray intersections and normals.

Rays are `origin + distance · direction`. Directions need not have unit length, so that a distance is the same (depth
along the viewing axis) in world and shape coordinates.

Points and directions are float32 (3, N), one row a coordinate: several times faster in numpy than (N, 3).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

# Replaces a zero divisor.
TINY = 1e-12


class Shape(Protocol):
    """Interface of a shape."""

    @property
    def radius(self) -> float:
        """Radius of a bounding sphere around the origin."""

    @property
    def is_convex(self) -> bool:
        """A convex shape casts no shadow on itself: its far side has n·l < 0."""

    def intersect(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Distance (N,) at which rays from outside enter the shape; negative, inf or NaN for a miss.

        origin (3, 1) or (3, N), direction (3, N). Compare with `<` or `>` only: both are false for NaN.
        """

    def normal(self, points: np.ndarray) -> np.ndarray:
        """Unit outward normal (3, N) at surface points (3, N)."""


@dataclass(frozen=True)
class Sphere:
    radius: float
    is_convex: bool = True

    def intersect(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        middle, half = _chord(origin, direction, self.radius)
        return middle - half

    def normal(self, points: np.ndarray) -> np.ndarray:
        return points / norm(points)


@dataclass(frozen=True)
class Dome:
    """A sphere seen from inside, for a distant background."""

    radius: float
    is_convex: bool = False

    def intersect(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        middle, half = _chord(origin, direction, self.radius)
        return middle + half

    def normal(self, points: np.ndarray) -> np.ndarray:
        return -points / norm(points)


@dataclass(frozen=True)
class Box:
    half: tuple[float, float, float]  # half edge lengths
    is_convex: bool = True

    @property
    def radius(self) -> float:
        return float(np.linalg.norm(self.half))

    def intersect(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        inverse = 1 / _nonzero(direction)
        centre, reach = -origin * inverse, np.abs(inverse) * column(self.half)
        enter, leave = (centre - reach).max(axis=0), (centre + reach).min(axis=0)
        return np.where(enter <= leave, enter, np.inf)

    def normal(self, points: np.ndarray) -> np.ndarray:
        relative = points / column(self.half)
        face, every = np.abs(relative).argmax(axis=0), np.arange(points.shape[1])
        normals = np.zeros_like(points)
        normals[face, every] = np.sign(relative[face, every])
        return normals


@dataclass(frozen=True)
class Rectangle:
    """A finite piece of the plane z = 0, seen from both sides, optionally with a rectangular hole."""

    half: tuple[float, float]
    hole: tuple[float, float, float, float] | None = None  # min x, min y, max x, max y
    is_convex: bool = True

    @property
    def radius(self) -> float:
        return float(np.linalg.norm(self.half))

    def intersect(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        distance = -origin[2] / _nonzero(direction[2])
        x, y = origin[:2] + distance * direction[:2]
        inside = (np.abs(x) <= self.half[0]) & (np.abs(y) <= self.half[1])
        if self.hole is not None:
            left, low, right, high = self.hole
            inside &= (x < left) | (x > right) | (y < low) | (y > high)
        return np.where(inside, distance, np.inf)

    def normal(self, points: np.ndarray) -> np.ndarray:
        return np.broadcast_to(column((0, 0, 1)), points.shape)


@dataclass(frozen=True)
class Ring:
    """A disc of thickness 2 half_height about the z axis with a round hole; inner = 0 makes a cylinder."""

    inner: float
    outer: float
    half_height: float

    @property
    def radius(self) -> float:
        return float(np.hypot(self.outer, self.half_height))

    @property
    def is_convex(self) -> bool:
        return self.inner == 0

    def intersect(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        # A ray enters through the cap facing it, the near side of the outer wall or the far side of the hole.
        distance = (-np.sign(direction[2]) * np.float32(self.half_height) - origin[2]) / _nonzero(direction[2])
        hit = origin[:2] + distance * direction[:2]
        squared = dot(hit, hit)
        best = np.where((squared <= self.outer**2) & (squared >= self.inner**2) & (distance > 0), distance, np.inf)
        middle, half = _chord(origin[:2], direction[:2], self.outer)
        walls = [middle - half]
        if self.inner > 0:
            middle, half = _chord(origin[:2], direction[:2], self.inner)
            walls.append(middle + half)
        for distance in walls:
            height = np.abs(origin[2] + distance * direction[2])
            np.copyto(best, distance, where=(distance > 0) & (distance < best) & (height <= self.half_height))
        return best

    def normal(self, points: np.ndarray) -> np.ndarray:
        around = norm(points[:2])
        outward = points / np.maximum(around, TINY)
        outward[2] = 0
        upward = np.zeros_like(points)
        upward[2] = np.sign(points[2])
        # A point lies on the surface nearest to it. Without a hole there is no inner wall.
        inner = np.abs(around - self.inner) if self.inner > 0 else np.full_like(around, np.inf)
        gaps = np.stack([np.abs(around - self.outer), inner, np.abs(np.abs(points[2]) - self.half_height)])
        return np.choose(gaps.argmin(axis=0), [outward, -outward, upward])


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products (N,) of the columns of (D, N) arrays."""
    total = a[0] * b[0]
    for i in range(1, len(a)):
        total += a[i] * b[i]
    return total


def norm(vectors: np.ndarray) -> np.ndarray:
    """Lengths (N,) of the columns of (D, N)."""
    return np.sqrt(dot(vectors, vectors))


def column(values: tuple[float, ...] | np.ndarray) -> np.ndarray:
    """A float32 column (D, 1) that broadcasts with (D, N) arrays."""
    return np.asarray(values, dtype=np.float32)[:, None]


def _chord(origin: np.ndarray, direction: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Distances middle ± half at which rays cross a circle or sphere around the origin; half is NaN for a miss.

    Computed from the ray's point nearest to the centre: in the textbook formula b² - c cancels for small far spheres.
    """
    squared = np.maximum(dot(direction, direction), np.float32(TINY))
    middle = -dot(origin, direction) / squared
    nearest = origin + middle * direction
    with np.errstate(invalid="ignore"):
        return middle, np.sqrt((np.float32(radius**2) - dot(nearest, nearest)) / squared)


def _nonzero(values: np.ndarray) -> np.ndarray:
    """The values with |x| < TINY replaced by TINY, as divisors."""
    return np.where(np.abs(values) < TINY, np.float32(TINY), values)
