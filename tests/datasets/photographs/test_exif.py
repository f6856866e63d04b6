"""EXIF turns of photographs with poses: applied where the cameras' size asks for it, else said."""

from __future__ import annotations

import json
from pathlib import Path

import dnerf_folder
import numpy as np
import pytest
from layout_folders import HEIGHT, WIDTH, picture, write_colmap, write_nerfstudio
from layout_scenes import check, read
from PIL import Image

from datasets.files.errors import SceneError
from datasets.files.image_files import exif_turn


def stored(upright: np.ndarray, path: Path, orientation: int = 6) -> None:
    """Writes a photograph as a phone held upright does: the sensor's pixels and a turn. 6: to be turned clockwise by
    90 degrees, 8: the other way, 3: by 180."""
    turns = {6: 1, 8: -1, 3: 2}[orientation]
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(np.ascontiguousarray(np.rot90(upright, turns))).save(path, exif=exif)


@pytest.mark.parametrize("orientation", [6, 8])
@pytest.mark.parametrize("layout", ["colmap", "nerfstudio"])
def test_images_are_turned_where_their_cameras_are(tmp_path: Path, layout: str, orientation: int) -> None:
    """Cameras and poses are of the upright images, of WIDTH x HEIGHT; pixels are those before they were stored."""
    root = write_colmap(tmp_path, True) if layout == "colmap" else write_nerfstudio(tmp_path)
    for index, path in enumerate(sorted((root / "images").iterdir())):
        stored(picture(index), path, orientation)
    scene, lines = read(root)
    check(scene)
    assert "EXIF: 12 of 12 images are turned upright, as the size of their cameras is" in lines


def test_sizes_that_fit_neither_way_are_refused(tmp_path: Path) -> None:
    for path in (write_colmap(tmp_path, True) / "images").iterdir():
        stored(np.zeros((HEIGHT, 2 * WIDTH, 3), np.uint8), path)
    with pytest.raises(SceneError, match=f"expected {WIDTH} x {HEIGHT} pixels, as its camera, or of that shape, found"):
        read(tmp_path)


def dnerf(root: Path, shape: tuple[int, int], orientation: int, **keys: object) -> tuple[np.ndarray, list[str]]:
    """(the first training image as it is read, what is said), of images that are upright of `shape` (H, W)."""
    upright = np.random.default_rng(0).integers(0, 255, (*shape, 3), np.uint8)
    for split in ("train", "test"):
        dnerf_folder.write_split(root, split, 3)
        for path in (root / split).iterdir():
            stored(upright, path, orientation)
        file = root / f"transforms_{split}.json"
        file.write_text(json.dumps({**json.loads(file.read_text()), **keys}))
    lines: list[str] = []
    scene = dnerf_folder.read(root, lines.append, downscale=1)
    assert np.array_equal(upright, np.asarray(scene.train[0].image)) == ("w" in keys)
    return np.asarray(scene.train[0].image), lines


def test_a_converters_size_turns_images_of_the_dnerf_layout(tmp_path: Path) -> None:
    image, lines = dnerf(tmp_path, (40, 30), 6, w=30, h=40, fl_x=41.0927)  # that of camera_angle_x
    assert image.shape == (40, 30, 3)
    assert "EXIF: 6 of 6 images are turned upright, as the size of their cameras is" in lines


@pytest.mark.parametrize("shape, orientation", [((30, 30), 6), ((30, 40), 3)])
def test_a_turn_that_the_size_does_not_show_is_said(tmp_path: Path, shape: tuple[int, int], orientation: int) -> None:
    _, lines = dnerf(tmp_path, shape, orientation)
    assert any(
        line.startswith("EXIF: 6 of 6 images have a turn (r_0.png), and their size does not show") for line in lines
    )


@pytest.mark.parametrize("orientation, expected", [(0, 1), (1, 1), (6, 6), (9, 1)])
def test_orientations_that_exif_does_not_know_are_none(tmp_path: Path, orientation: int, expected: int) -> None:
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.new("RGB", (40, 30)).save(tmp_path / "a.png", exif=exif)
    assert exif_turn(tmp_path / "a.png") == expected
