"""Which kind of scene a configuration names. Several videos, whose kind is in their pictures: clip/test_several.py."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from clips import write_clip

from datasets import SceneError, SceneKind, scene_kind
from datasets.settings import SceneConfig

NOISE = np.random.default_rng(0).integers(0, 256, (10, 48, 64, 3), dtype=np.uint8)


@pytest.mark.parametrize(
    "name, reader, kind",
    [
        ("synthetic/wheel", "synthetic", "photographs"),
        ("synthetic/counter", "synthetic", "posed_videos"),
        ("synthetic/street", "synthetic", "drive"),
        ("dnerf/lego", "dnerf", "photographs"),
        ("own", "colmap", "photographs"),
        ("own", "plenoptic", "posed_videos"),
        ("own", "kitti", "drive"),
        ("own", "waymo", "drive"),
    ],
)
def test_the_reader_says_the_kind(name: str, reader: str, kind: SceneKind) -> None:
    assert scene_kind(SceneConfig(name, reader)) == kind


def test_one_video_is_a_clip_whatever_its_reader(tmp_path: Path) -> None:
    write_clip(tmp_path / "clip.mp4", list(NOISE), range(len(NOISE)))
    for reader in ("video", "auto"):
        assert scene_kind(SceneConfig("own", reader, str(tmp_path / "clip.mp4"))) == "clip"


def test_videos_without_a_path_are_named() -> None:
    for reader in ("video", "auto"):
        with pytest.raises(SceneError, match="scene.path: expected the folder of the data"):
            scene_kind(SceneConfig("own", reader))
