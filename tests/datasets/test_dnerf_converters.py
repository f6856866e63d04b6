"""The D-NeRF reader on what converters write: images without alpha, a split too few, other endings of files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dnerf_folder import SIZE, read, write_folder
from PIL import Image

from datasets.scene import SceneError


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_folder(tmp_path)


# --- the background of images without alpha ------------------------------------------------------------------------


def opaque_disc(root: Path, border: int, inside: int = 60) -> Path:
    """Every image RGB: one level all over, a smaller square of another in it that reaches the lower edge."""
    for split in ("train", "test"):
        for path in (root / split).iterdir():
            image = np.full((SIZE, SIZE, 3), border, np.uint8)
            image[4:, 3:5] = inside
            Image.fromarray(image).save(path)
    return root


def test_the_background_of_opaque_images_is_the_colour_of_their_borders(folder: Path) -> None:
    told: list[str] = []
    scene = read(opaque_disc(folder, 255), background=None, downscale=1, log=told.append)
    assert scene.background == (1.0, 1.0, 1.0)
    assert told == ["scene.background: white, the colour of the images' borders; scene.background=black overrides"]
    assert read(opaque_disc(folder, 253), background=None, downscale=1).background == (1.0, 1.0, 1.0)
    assert read(opaque_disc(folder, 3), background=None, downscale=1).background == (0.0, 0.0, 0.0)
    assert read(opaque_disc(folder, 102), background=None, downscale=1).background == (0.4, 0.4, 0.4)


def test_a_background_that_is_asked_for_stays_and_is_remarked_on(folder: Path) -> None:
    told: list[str] = []
    scene = read(opaque_disc(folder, 255), background=(0.0, 0.0, 0.0), downscale=1, log=told.append)
    assert scene.background == (0.0, 0.0, 0.0)
    assert told == ["scene.background: black, as asked for, though the images' borders are white"]


def test_images_with_alpha_and_photographs_stay_over_black(folder: Path) -> None:
    told: list[str] = []
    assert read(folder, background=None, log=told.append).background == (0.0, 0.0, 0.0)  # random, with alpha
    for path in (folder / "train").iterdir():
        Image.open(path).convert("RGB").save(path)  # random, opaque: borders of many colours
    assert read(folder, background=None, log=told.append).background == (0.0, 0.0, 0.0)
    assert told == []


# --- layouts that converters write ----------------------------------------------------------------------------------


def test_a_missing_split_says_what_makes_do_without_it(folder: Path) -> None:
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


def test_a_single_transforms_file_is_the_training_split(folder: Path) -> None:
    expected = read(folder, test_split=None)
    (folder / "transforms_train.json").rename(folder / "transforms.json")
    found = read(folder, test_split=None)
    assert [view.name for view in found.train] == [view.name for view in expected.train]
    with pytest.raises(SceneError, match="scene.validation_every=8"):
        (folder / "transforms_test.json").unlink()
        read(folder)


@pytest.mark.parametrize("ending", ["jpg", "jpeg", "JPG", "PNG"])
def test_other_endings_may_be_left_out_too(folder: Path, ending: str) -> None:
    for path in list((folder / "train").iterdir()):
        Image.open(path).convert("RGB").save(path.with_suffix(f".{ending}"))
        path.unlink()
    assert [view.name for view in read(folder).train] == ["train/r_0", "train/r_1", "train/r_2"]
