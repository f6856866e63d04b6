"""Images over a background: alpha composed once, and the background of images that have no alpha."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

Color = tuple[float, float, float]  # RGB in [0, 1]
BLACK: Color = (0.0, 0.0, 0.0)
WHITE: Color = (1.0, 1.0, 1.0)

BORDER_TOLERANCE = 8  # levels of 255: what JPEG makes of one colour
BORDER_SHARE = 0.9  # of all border pixels; an object may reach over some of them, a photograph's are never so alike


def compose(rgba: np.ndarray, background: Color, downscale: int = 1) -> np.ndarray:
    """An RGBA image with straight alpha (H, W, 4) uint8 over `background`, averaged over downscale² pixels.

    Premultiplied colour and alpha are averaged, then composed, then rounded once; both steps being linear, this is
    composing at full size and averaging that. Averaging straight colour instead would let the colour that hides
    under transparent pixels leak into the edges. Rows and columns at the end that fill no block are left out.
    Returns (H // downscale, W // downscale, 3) uint8.
    """
    alpha = rgba[..., 3].astype(np.float32) / 255
    see_through = 255 * (1 - _block_means(alpha, downscale))
    # One channel at a time: numpy is several times faster on planes than on interleaved pixels.
    channels = [
        _block_means(rgba[..., c] * alpha, downscale) + np.float32(background[c]) * see_through for c in range(3)
    ]
    return np.rint(np.stack(channels, axis=-1)).astype(np.uint8)


def coverage(rgba: np.ndarray, downscale: int = 1) -> np.ndarray | None:
    """How much of each pixel of `compose`'s image is not background, (H, W) uint8; None where nothing is background."""
    alpha = rgba[..., 3]
    return None if alpha.min() == 255 else np.rint(_block_means(alpha.astype(np.float32), downscale)).astype(np.uint8)


def _block_means(plane: np.ndarray, side: int) -> np.ndarray:
    """Means (H // side, W // side) of the whole side × side blocks of (H, W)."""
    plane = plane[: plane.shape[0] // side * side, : plane.shape[1] // side * side]
    return sum(plane[i::side, j::side] for i in range(side) for j in range(side)) / np.float32(side**2)


def border_color(images: Sequence[np.ndarray]) -> Color | None:
    """The one colour that the borders of opaque images (H, W, 3) uint8 show: their background. None: many colours.

    Nearly black or white is taken for black or white.
    """
    borders = np.concatenate([np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]]) for image in images])
    usual = np.median(borders, axis=0)
    alike = (np.abs(borders - usual) <= BORDER_TOLERANCE).all(axis=1)
    if alike.mean() < BORDER_SHARE:
        return None
    usual = np.where(usual <= BORDER_TOLERANCE, 0, np.where(usual >= 255 - BORDER_TOLERANCE, 255, usual))
    if np.ptp(usual) == 0 and usual[0] in (0, 255):
        return (float(usual[0] / 255),) * 3
    return tuple((np.median(borders[alike], axis=0) / 255).tolist())
