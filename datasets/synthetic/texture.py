"""Procedural solid textures: colour as a function of the point in the object's own frame.

A texture is any callable (3, N) float32 points -> (3, N) RGB in [0, 1]. Solid textures need no surface coordinates.
At 200 pixels a side and distance 4 one pixel covers 0.014 world units: features of 0.05 and more can be learned.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from datasets.synthetic.shapes import column

Texture = Callable[[np.ndarray], np.ndarray]
Colour = tuple[float, float, float]

NOISE_WAVES = 14  # enough to hide the single waves


def plain(colour: Colour) -> Texture:
    return lambda points: np.broadcast_to(column(colour), points.shape)


def select(index: np.ndarray, parts: Sequence[Texture], points: np.ndarray) -> np.ndarray:
    """Colour (3, N): texture parts[index] for each point; each part is evaluated at its own points only."""
    colours = np.empty_like(points)
    for number, part in enumerate(parts):
        inside = np.flatnonzero(index == number)
        colours[:, inside] = part(points.take(inside, axis=1))
    return colours


def checker(even: Texture, odd: Texture, size: float) -> Texture:
    """Alternating cubes of edge `size`. The shift by ¼ keeps faces through the origin off the cell boundaries."""
    return lambda points: select(np.floor(points / np.float32(size) + 0.25).sum(axis=0) % 2, (even, odd), points)


def tiles(even: Texture, odd: Texture, size: float) -> Texture:
    """A checker in x and y only, for floors: rounding in z does not change it."""
    return lambda points: select(np.floor(points[:2] / np.float32(size) + 0.25).sum(axis=0) % 2, (even, odd), points)


def stripes(even: Texture, odd: Texture, width: float, direction: tuple[float, float, float]) -> Texture:
    """Layers of `width` across `direction`."""
    across = np.asarray(direction, dtype=np.float32) / np.float32(np.linalg.norm(direction) * width)
    return lambda points: select(np.floor(across @ points) % 2, (even, odd), points)


def sectors(parts: Sequence[Texture]) -> Texture:
    """Equal slices about the z axis, one texture each."""

    def texture(points: np.ndarray) -> np.ndarray:
        turn = np.arctan2(points[1], points[0]) / np.float32(2 * np.pi) % 1
        return select(np.minimum(np.floor(turn * len(parts)), len(parts) - 1), parts, points)

    return texture


def mosaic(dark: Colour, light: Colour, size: float, rng: np.random.Generator) -> Texture:
    """Cubes of edge `size`, each in its own mixture of two colours, so that features can be matched."""
    table = rng.permutation(256)

    def texture(points: np.ndarray) -> np.ndarray:
        x, y, z = np.floor(points / np.float32(size) + np.float32(0.25)).astype(np.int32)
        cell = table[(x + table[(y + table[z & 255]) & 255]) & 255]  # Perlin's hash; repeats after 256 cells
        return _mix(dark, light, (cell / np.float32(255)).astype(np.float32))

    return texture


def average(*parts: Texture) -> Texture:
    """The mean of several textures, for detail at several scales."""
    return lambda points: np.asarray(sum(part(points) for part in parts)) / np.float32(len(parts))


def mottled(dark: Colour, light: Colour, scale: float, rng: np.random.Generator) -> Texture:
    """Two colours mixed by cloudy noise with features of about `scale`, world units."""
    noise = plane_wave_noise(scale, rng)
    # Noise of unit variance: ± 1.4 standard deviations reach from one colour to the other.
    return lambda points: _mix(dark, light, np.clip(0.5 + noise(points) / np.float32(2.8), 0, 1))


def marble(dark: Colour, light: Colour, scale: float, rng: np.random.Generator) -> Texture:
    """Two colours in wavy veins about `scale` wide: bands across (1, 1, 1) shifted by noise."""
    noise = plane_wave_noise(2 * scale, rng)

    def texture(points: np.ndarray) -> np.ndarray:
        phase = points.sum(axis=0) * np.float32(np.pi / scale / 3**0.5) + np.float32(1.3) * noise(points)
        return _mix(dark, light, 0.5 + 0.5 * np.sin(phase))

    return texture


def plane_wave_noise(scale: float, rng: np.random.Generator) -> Callable[[np.ndarray], np.ndarray]:
    """Smooth noise (3, N) -> (N,), mean 0, variance 1: a sum of plane waves in random directions.

    Wavelengths from scale to 2.5 scale: no detail is finer than half of `scale`.
    """
    directions = rng.normal(size=(NOISE_WAVES, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    wavelengths = scale * 2.5 ** rng.random(NOISE_WAVES)
    waves = (2 * np.pi * directions / wavelengths[:, None]).astype(np.float32)
    phases = (2 * np.pi * rng.random((NOISE_WAVES, 1))).astype(np.float32)
    gain = np.float32((2 / NOISE_WAVES) ** 0.5)  # each sine has variance ½
    return lambda points: gain * np.sin(waves @ points + phases).sum(axis=0)


def _mix(dark: Colour, light: Colour, amount: np.ndarray) -> np.ndarray:
    return column(dark) + (column(light) - column(dark)) * amount
