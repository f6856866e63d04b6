"""scene=auto on folders in D-NeRF's layout that lack what the paper's have."""

from __future__ import annotations

from pathlib import Path

import pytest
from dnerf_folder import SIZE, edit, write_folder, write_split
from layout_scenes import read

from datasets.files.errors import SceneError


def test_without_a_test_split_val_is_held_out(tmp_path: Path) -> None:
    (write_folder(tmp_path) / "transforms_test.json").unlink()
    scene, lines = read(tmp_path)
    assert len(scene.test) == 2 and all("val/" in view.name for view in scene.test)
    assert any("there is no transforms_test.json; held out: transforms_val.json" in line for line in lines)


def test_without_any_split_every_eighth_training_view_is_held_out(tmp_path: Path) -> None:
    write_split(tmp_path, "train", 17)
    scene, lines = read(tmp_path)
    assert len(scene.test) == 2 and len(scene.train) == 15
    assert any("held out: every 8th training view" in line for line in lines)


def test_small_images_keep_their_size(tmp_path: Path) -> None:
    """The longer side is at most 640 pixels; D-NeRF's own images, of 800, are halved."""
    assert read(write_folder(tmp_path))[0].train[0].camera.width == SIZE


def test_masks_are_refused(tmp_path: Path) -> None:
    """The reader has none, and would train on what they leave out."""
    edit(write_folder(tmp_path), lambda content: content["frames"][0].update(mask_path="masks/r_0.png"))
    with pytest.raises(
        SceneError, match=r"transforms_train\.json: expected no mask_path \(scene\.reader=nerfstudio obeys"
    ):
        read(tmp_path)
