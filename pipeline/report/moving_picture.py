"""A picture of the dynamic region in a held-out view: render and truth with its outline, and both enlarged there.

A moving object that a model has lost is a small part of an image; here it is seen at once.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import binary_dilation, find_objects, label

PARTS = ("render, dynamic region outlined", "truth", "render, enlarged", "truth, enlarged")
OUTLINE = (255, 0, 200)  # RGB; rare in photographs
_MARGIN = 0.15  # of the enlarged object's size, on every side
_SMALLEST = 24  # pixels, side of what is enlarged

Box = tuple[int, int, int, int]  # left, upper, right, lower, as in PIL


def moving_parts(renders: Path, view: str) -> list[Image.Image]:
    """The pictures of PARTS, all of the image's size. Raises whatever PIL raises for missing and damaged images."""
    with Image.open(renders / f"{view}_moving.png") as image:
        mask = np.asarray(image.convert("L")) > 0
    pictures = []
    for part in ("render", "truth"):
        with Image.open(renders / f"{view}_{part}.png") as image:
            pictures.append(image.convert("RGB"))
    box = enlarged_box(mask)
    enlarged = [picture.crop(box).resize(picture.size, Image.Resampling.LANCZOS) for picture in pictures]
    return [*(outlined(picture, mask) for picture in pictures), *enlarged]


def moving_count(renders: Path, view: str) -> int:
    """The moving pixels of a view's mask; 0 if it cannot be read."""
    try:
        with Image.open(renders / f"{view}_moving.png") as image:
            return int((np.asarray(image.convert("L")) > 0).sum())
    except Exception:  # PIL raises many types for damaged files
        return 0


def outlined(picture: Image.Image, mask: np.ndarray) -> Image.Image:
    """The picture with a line around the mask (H, W) bool, outside of it."""
    width = max(1, round(max(picture.size) / 400))
    pixels = np.asarray(picture).copy()
    pixels[binary_dilation(mask, np.ones((3, 3)), iterations=width) & ~mask] = OUTLINE
    return Image.fromarray(pixels)


def enlarged_box(mask: np.ndarray) -> Box:
    """A box around the largest connected part of the mask, of the image's proportions and inside of it."""
    height, width = mask.shape
    parts, count = label(mask, np.ones((3, 3)))
    if not count:
        return 0, 0, width, height
    rows, columns = find_objects(parts)[int(np.bincount(parts.ravel())[1:].argmax())]
    needed = [(1 + 2 * _MARGIN) * (part.stop - part.start) for part in (columns, rows)]
    share = min(1.0, max(needed[0] / width, needed[1] / height, _SMALLEST / min(height, width)))
    size = max(1, round(share * width)), max(1, round(share * height))
    left, upper = (
        int(np.clip((part.start + part.stop - side) // 2, 0, whole - side))
        for part, side, whole in zip((columns, rows), size, (width, height))
    )
    return left, upper, left + size[0], upper + size[1]
