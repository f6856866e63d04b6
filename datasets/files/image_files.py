"""Reads image files with Pillow: pixels as RGBA, sizes from the headers alone."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image, ImageOps

from datasets.files.errors import SceneError

SIDEWAYS = (5, 6, 7, 8)  # EXIF orientations that exchange width and height


def is_file(path: Path) -> bool:
    """Path.is_file, of any name that a file may state."""
    try:
        return path.is_file()
    except OSError:  # a name that is too long, a folder without permission
        return False


def common_size(paths: Sequence[Path]) -> tuple[int, int]:
    """(width, height) of all images, from their headers. SceneError if they differ or a file is no image."""
    first = image_size(paths[0])
    for path in paths[1:]:
        if (size := image_size(path)) != first:
            raise SceneError(path, "{} x {} pixels as {}".format(*first, paths[0].name), "{} x {}".format(*size))
    return first


def image_size(path: Path) -> tuple[int, int]:
    """(width, height) of an image, from its header. SceneError if the file is none."""
    try:
        with Image.open(path) as image:
            return image.size
    except FileNotFoundError:
        raise SceneError(path, "an image", "no such file") from None
    except Exception as error:  # PIL raises many types for broken files
        raise SceneError(path, "a readable image", str(error)) from None


def oriented_size(path: Path, wanted: tuple[float, float] | None) -> tuple[tuple[int, int], bool]:
    """((width, height), whether it is that of the image turned as its EXIF orientation says), from the header.

    Turned only if the shape `wanted`, at any scale, is that of the turned image alone: known poses are of the pixels
    as stored unless their camera's shape says otherwise.
    """
    size = image_size(path)
    if wanted is None or same_shape(size, wanted) or not same_shape(size[::-1], wanted):
        return size, False
    return (size[::-1], True) if exif_turn(path) in SIDEWAYS else (size, False)


def same_shape(size: tuple[int, int], wanted: tuple[float, float]) -> bool:
    """Whether an image (width, height) may be one of `wanted` at another scale; a side is rounded to a pixel."""
    scale = max(size[0] / wanted[0], size[1] / wanted[1])
    return max(abs(size[0] - scale * wanted[0]), abs(size[1] - scale * wanted[1])) <= 1


def exif_turn(path: Path) -> int:
    """The EXIF orientation, 1 to 8; 1: as stored, also where there is none."""
    try:
        with Image.open(path) as image:
            turn = int(image.getexif().get(ExifTags.Base.Orientation, 1))
            return turn if 1 <= turn <= 8 else 1  # 0, as some programs write: unknown
    except Exception as error:  # PIL raises many types for broken files
        raise SceneError(path, "a readable image", str(error)) from None


def has_alpha(path: Path) -> bool:
    """Whether the image may be transparent somewhere, from its header. SceneError if the file is no image."""
    try:
        with Image.open(path) as image:
            return image.mode in ("RGBA", "LA", "PA", "La", "RGBa") or "transparency" in image.info
    except Exception as error:  # PIL raises many types for broken files
        raise SceneError(path, "a readable image", str(error)) from None


def read_rgba(path: Path, upright: bool = False) -> np.ndarray:
    """(H, W, 4) uint8 RGBA with straight alpha, which is 255 if the file has none. SceneError for more than 8 bits.

    upright: turned as its EXIF orientation says. Known poses are of the pixels as stored.
    """
    try:
        with Image.open(path) as image:
            # Pillow would keep the upper 8 bits of 16 in colour; then only the packing of the file's pixels says so.
            found = next((str(tile[3]) for tile in image.tile if re.search(";16[BLN]", str(tile[3]))), "")
            found = image.mode if image.mode.startswith(("I", "F")) else found
            rgba = np.asarray((ImageOps.exif_transpose(image) if upright else image).convert("RGBA"))
    except Exception as error:  # a truncated file is detected only on decoding
        raise SceneError(path, "a readable image", str(error)) from None
    if found:
        raise SceneError(path, "8 bits a channel", f"image mode {found}")
    return rgba
