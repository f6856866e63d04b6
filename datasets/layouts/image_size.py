"""Photographs of one size: cameras scaled to images that were reduced, images of nearly one size cut."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from datasets.files.errors import SceneError
from datasets.files.image_files import image_size
from datasets.layouts.photograph import Photograph
from datasets.scene import make_camera

# Of a side. colmap image_undistorter makes images whose sizes differ by a few percent where each has a lens of its own.
LARGEST_CUT = 0.1


def of_one_size(photographs: Sequence[Photograph]) -> tuple[list[Photograph], tuple[int, int]]:
    """The photographs with cameras of one size, and that (width, height).

    A camera of another size than its image is scaled, if both have one shape. Images of different sizes lose their
    right and lower border, LARGEST_CUT of a side at most; principal points stay. SceneError for others.
    """
    found = [_scaled(photograph, image_size(photograph.path)) for photograph in photographs]
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


def _scaled(photograph: Photograph, size: tuple[int, int]) -> Photograph:
    """With the camera, and the lens, of an image of `size`."""
    camera, (width, height) = photograph.camera, size
    if (camera.width, camera.height) == size:
        return photograph
    scale = max(width / camera.width, height / camera.height)
    if max(abs(width - scale * camera.width), abs(height - scale * camera.height)) > 1:  # a side is rounded
        expected = f"{camera.width} x {camera.height} pixels, as its camera, or of that shape"
        raise SceneError(photograph.path, expected, f"{width} x {height}")
    small = make_camera(photograph.path, lambda: camera.resized(width, height))
    return replace(photograph, camera=small, lens=photograph.lens and photograph.lens.scaled_to(small))
