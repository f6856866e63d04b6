"""The D-NeRF reader on the output of converters: images without alpha, missing splits, other file suffixes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dnerf_folder import SIZE, read, write_folder
from PIL import Image

from datasets.files.errors import SceneError


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_folder(tmp_path)


# --- the background of images without alpha ---------------------------------------------------------------------------


def write_opaque_images(root: Path, border: int, inside: int = 60) -> Path:
    """Makes all images RGB of level `border`, with a square of level `inside` at the lower edge."""
    for split in ("train", "test"):
        for path in (root / split).iterdir():
            image = np.full((SIZE, SIZE, 3), border, np.uint8)
            image[4:, 3:5] = inside
            Image.fromarray(image).save(path)
    return root


def test_background_of_opaque_images_is_their_border_colour(folder: Path) -> None:
    logged: list[str] = []
    scene = read(write_opaque_images(folder, 255), background="auto", downscale=1, log=logged.append)
    assert scene.background == (1.0, 1.0, 1.0)
    assert logged == ["scene.background: white, the border colour of the images; scene.background=black overrides"]
    assert read(write_opaque_images(folder, 253), background="auto", downscale=1).background == (1.0, 1.0, 1.0)
    assert read(write_opaque_images(folder, 3), background="auto", downscale=1).background == (0.0, 0.0, 0.0)
    assert read(write_opaque_images(folder, 102), background="auto", downscale=1).background == (0.4, 0.4, 0.4)


def test_background_setting_overrides_the_border_colour(folder: Path) -> None:
    logged: list[str] = []
    scene = read(write_opaque_images(folder, 255), background=(0.0, 0.0, 0.0), downscale=1, log=logged.append)
    assert scene.background == (0.0, 0.0, 0.0)
    assert logged == ["scene.background: black as set, but the images' borders are white"]


def test_background_of_alpha_images_and_photographs_is_black(folder: Path) -> None:
    logged: list[str] = []
    assert read(folder, background="auto", log=logged.append).background == (0.0, 0.0, 0.0)  # random, with alpha
    for path in (folder / "train").iterdir():
        Image.open(path).convert("RGB").save(path)  # random, opaque: no common border colour
    assert read(folder, background="auto", log=logged.append).background == (0.0, 0.0, 0.0)
    assert logged == []


# --- other layouts ----------------------------------------------------------------------------------------------------


def test_message_about_a_missing_split_suggests_settings(folder: Path) -> None:
    (folder / "transforms_test.json").unlink()
    with pytest.raises(
        SceneError,
        match=r"transforms_test.json: expected a file .*, found none; transforms_val.json is "
        r"there: scene.test_split=val takes it; scene.validation_every=8 holds out",
    ):
        read(folder)
    assert [view.name for view in read(folder, test_split="val").test] == ["val/r_0", "val/r_1"]
    (folder / "transforms_val.json").unlink()
    with pytest.raises(SceneError, match=r"found none; scene.validation_every=8 holds out every eighth"):
        read(folder)
    scene = read(folder, test_split=None)
    assert (len(scene.train), scene.test) == (3, ())


def test_single_transforms_file_is_the_training_split(folder: Path) -> None:
    expected = read(folder, test_split=None)
    (folder / "transforms_train.json").rename(folder / "transforms.json")
    found = read(folder, test_split=None)
    assert [view.name for view in found.train] == [view.name for view in expected.train]
    with pytest.raises(SceneError, match="scene.validation_every=8"):
        (folder / "transforms_test.json").unlink()
        read(folder)


@pytest.mark.parametrize("suffix", ["jpg", "jpeg", "JPG", "PNG"])
def test_file_path_without_suffix(folder: Path, suffix: str) -> None:
    for path in list((folder / "train").iterdir()):
        Image.open(path).convert("RGB").save(path.with_suffix(f".{suffix}"))
        path.unlink()
    assert [view.name for view in read(folder).train] == ["train/r_0", "train/r_1", "train/r_2"]
