"""Test views that are training views, and those that only look alike."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import dnerf_folder
import numpy as np
import pytest
from PIL import Image

from datasets.leaks import trained_test_views
from pipeline.data.prepare import name_leaks


def copied(root: Path, quality: int | None = None) -> Path:
    """D-NeRF's layout; the first two of three test images are training images 1 and 3 under other names, with their
    poses and times. quality: of the copies as JPEG; None: the same files."""
    dnerf_folder.write_split(root, "train", 5)
    dnerf_folder.write_split(root, "test", 3, seed=1)
    train, test = (json.loads((root / f"transforms_{split}.json").read_text()) for split in ("train", "test"))
    for index, other in ((0, 1), (1, 3)):
        own, source = root / f"test/r_{index:03d}.png", root / f"train/r_{other}.png"
        if quality is None:
            shutil.copyfile(source, own)
        else:
            Image.fromarray(np.full((dnerf_folder.SIZE, dnerf_folder.SIZE, 3), 40 * other, np.uint8)).save(source)
            noise = np.random.default_rng(0).integers(0, quality, (dnerf_folder.SIZE, dnerf_folder.SIZE, 3))
            Image.fromarray((40 * other + noise).astype(np.uint8)).save(own)
        test["frames"][index] = {**train["frames"][other], "file_path": f"./test/r_{index:03d}"}
    (root / "transforms_test.json").write_text(json.dumps(test))
    return root


@pytest.mark.parametrize("noise", [None, 3])
def test_copies_are_named_in_log_and_table(tmp_path: Path, noise: int | None) -> None:
    """Equal files; or pictures up to 2 levels apart, as after another compression."""
    scene = dnerf_folder.read(copied(tmp_path, noise))
    lines: list[str] = []
    said = name_leaks(scene, lines.append)
    assert trained_test_views(scene) == [("test/r_000", "train/r_1"), ("test/r_001", "train/r_3")]
    assert lines == [
        "2 of 3 test views are training views (test/r_000 is train/r_1): their numbers are no held-out ones"
    ]
    assert said.test_split == "the test split; 2 of 3 test views are training views"


def test_another_picture_from_the_same_place_and_pictures_of_one_colour_are_no_copies(tmp_path: Path) -> None:
    assert trained_test_views(dnerf_folder.read(copied(tmp_path / "noise", 60))) == []
    root = copied(tmp_path / "black")
    for path in root.rglob("*.png"):
        Image.new("RGB", (dnerf_folder.SIZE, dnerf_folder.SIZE)).save(path)
    assert trained_test_views(dnerf_folder.read(root)) == []
    scene = dnerf_folder.read(root)
    assert name_leaks(scene, print) is scene
