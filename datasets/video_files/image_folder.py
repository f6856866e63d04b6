"""A folder of images in order as frames of a clip."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from datasets.composition import BLACK, Color, compose
from datasets.files.errors import SceneError
from datasets.files.image_files import read_rgba
from datasets.files.natural_order import about_even, last_number, natural_order
from datasets.files.unused_masks import is_mask
from datasets.video_files.frame import Frame
from datasets.video_files.times import USUAL_RATE

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff")


def image_paths(folder: Path) -> list[Path]:
    """The images of a folder in the natural order of their names, without the masks of others."""
    paths = [p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith(".")]
    if not all(map(is_mask, paths)):
        paths = [path for path in paths if not is_mask(path)]
    return sorted(paths, key=lambda path: natural_order(path.name))


def image_times(paths: list[Path]) -> np.ndarray:
    """(images,) seconds since the first: by the numbers in their names if these ascend, so that gaps remain.

    The median step is a frame at USUAL_RATE. Evenly spaced without such numbers.
    """
    found = [last_number(path.stem) for path in paths]
    numbers = np.array(found, dtype=np.float64)  # None becomes NaN
    if not (about_even(found) and (np.diff(numbers) > 0).all()):
        return np.arange(len(paths)) / USUAL_RATE
    return (numbers - numbers[0]) / np.median(np.diff(numbers)) / USUAL_RATE


def image_frames(
    paths: list[Path], keep: set[int] | None = None, every: int = 1, background: Color = BLACK
) -> Iterator[Frame]:
    """Images, upright, as frames at `image_times`; a damaged file comes without an image. SceneError unless all have
    one size.

    background: under transparent pixels.
    """
    first: tuple[str, tuple[int, int]] | None = None
    for index, (path, time) in enumerate(zip(paths, image_times(paths).tolist(), strict=True)):
        if (keep is not None and index not in keep) or index % every:
            continue
        try:
            image = compose(read_rgba(path, upright=True), background)
        except SceneError:
            image = None
        if image is not None:
            stored = (image.shape[1], image.shape[0])
            first = first or (path.name, stored)
            if stored != first[1]:
                raise SceneError(path, f"{_pixels(first[1])}, the size of {first[0]}", _pixels(stored))
        yield Frame(index, time, image)


def _pixels(size: tuple[int, int]) -> str:
    return f"{size[0]} x {size[1]} pixels"
