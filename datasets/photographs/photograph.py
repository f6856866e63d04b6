"""`PosedFile`: an image file with its camera and time, as any layout describes it; those of a scene have one size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from datasets.files.errors import SceneError
from datasets.files.image_files import SIDEWAYS, exif_turn, oriented_size, read_rgba
from datasets.scene import make_camera
from datasets.source import Log
from rasterizer.camera import Camera

if TYPE_CHECKING:  # imports OpenCV, which few scenes need
    from datasets.cameras.lens import Lens

# Of a side. colmap image_undistorter makes images whose sizes differ by a few percent where each has a lens of its own.
LARGEST_CUT = 0.1


@dataclass(frozen=True)
class PosedFile:
    """An image file with its camera."""

    name: str  # unique; numbers in it give the order in time
    path: Path
    camera: Camera  # of the full-size, undistorted image
    lens: Lens | None = None  # None: no distortion
    time: float | None = None  # any unit and origin; None: unknown
    group: int = 0  # number of the physical camera
    test: bool | None = None  # held out by the layout; None: the layout does not say
    mask: Path | None = None  # an image, 0 where pixels do not count; None: all count
    folder: str = ""  # what names the physical camera: a folder, or a part of the file names
    size: tuple[int, int] | None = None  # (width, height) of the file, which is cut to the camera's; None: the camera's
    moment: str | None = None  # the part of the name that says when; None: the file name
    upright: bool = False  # read as its EXIF orientation says, as its camera's size does

    @property
    def file_size(self) -> tuple[int, int]:
        """(width, height) of the file, pixels."""
        return self.size or (self.camera.width, self.camera.height)

    def read(self) -> np.ndarray:
        """(H, W, 4) uint8 of the file, undistorted and cut to the size of its camera, with straight alpha."""
        rgba, (width, height) = read_rgba(self.path, self.upright), self.file_size
        if rgba.shape[:2] != (height, width):
            expected = f"{width} x {height} pixels, as its header says"
            raise SceneError(self.path, expected, "{1} x {0}".format(*rgba.shape))
        if self.lens:
            from datasets.cameras.lens import undistort_rgba

            rgba = undistort_rgba(rgba, self.lens.maps((width, height)))
        return rgba[: self.camera.height, : self.camera.width]

    def imaged(self, reduced: Camera) -> np.ndarray | None:
        """(h, w) bool: the pixels of the image of `reduced`, the camera at a smaller size, that the lens has imaged;
        None: all."""
        if self.lens is None:
            return None
        from datasets.cameras.lens import imaged

        return imaged(self.lens, (self.camera.width, self.camera.height), (reduced.width, reduced.height))


def say_folds(photographs: Sequence[PosedFile], log: Log) -> None:
    """A line for a lens that folds inside its image; the first of several."""
    lenses = dict.fromkeys((p.lens, (p.camera.width, p.camera.height)) for p in photographs)
    for lens, size in lenses:
        if lens is not None:
            from datasets.cameras.lens import fold_line

            if line := fold_line(lens, size):
                log(line)
                return


def say_turns(photographs: Sequence[PosedFile], log: Log) -> None:
    """A line on images that EXIF turns: which are, and which may have been meant to be."""
    turned = [p for p in photographs if exif_turn(p.path) != 1]
    if upright := sum(p.upright for p in turned):
        log(f"EXIF: {upright} of {len(photographs)} images are turned upright, as the size of their cameras is")
    unknown = [p for p in turned if not p.upright and (exif_turn(p.path) not in SIDEWAYS or _is_square(p))]
    if unknown:
        log(
            f"EXIF: {len(unknown)} of {len(photographs)} images have a turn ({unknown[0].path.name}), and their size "
            "does not show whether poses are of the turned image: they are taken as of the pixels as stored"
        )


def _is_square(photograph: PosedFile) -> bool:
    width, height = photograph.file_size
    return width == height


def of_one_size(photographs: Sequence[PosedFile]) -> tuple[list[PosedFile], tuple[int, int]]:
    """The photographs with cameras of one size, and that (width, height).

    A camera of another size than its image is scaled, if both have one shape. Images of different sizes lose their
    right and lower border, LARGEST_CUT of a side at most; principal points stay. SceneError for others.
    """
    found = [_scaled(photograph) for photograph in photographs]
    sizes = [(photograph.camera.width, photograph.camera.height) for photograph in found]
    smallest = min(width for width, _ in sizes), min(height for _, height in sizes)
    for photograph, size in zip(found, sizes):
        if any(small < (1 - LARGEST_CUT) * side for small, side in zip(smallest, size)):
            first = next(i for i, other in enumerate(sizes) if other != size)
            raise SceneError(
                photograph.path,
                "about {} x {} pixels as {}; scale all images to one size".format(
                    *sizes[first], found[first].path.name
                ),
                "{} x {}".format(*size),
            )
    width, height = smallest
    return [
        photograph
        if size == smallest
        else replace(photograph, camera=replace(photograph.camera, width=width, height=height), size=size)
        for photograph, size in zip(found, sizes)
    ], smallest


def _scaled(photograph: PosedFile) -> PosedFile:
    """With the camera, and the lens, of the image's size."""
    camera = photograph.camera
    size, upright = oriented_size(photograph.path, (camera.width, camera.height))
    photograph, (width, height) = replace(photograph, upright=upright), size
    if (camera.width, camera.height) == size:
        return photograph
    scale = max(width / camera.width, height / camera.height)
    if max(abs(width - scale * camera.width), abs(height - scale * camera.height)) > 1:  # a side is rounded
        expected = f"{camera.width} x {camera.height} pixels, as its camera, or of that shape"
        raise SceneError(photograph.path, expected, f"{width} x {height}")
    small = make_camera(photograph.path, lambda: camera.resized(width, height))
    return replace(photograph, camera=small, lens=photograph.lens and photograph.lens.scaled_to(small))
