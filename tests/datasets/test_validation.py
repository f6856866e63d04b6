"""Validation splits: every training view in exactly one part, no test view in either."""

from __future__ import annotations

import pytest
from tiny import tiny_scene
from tiny_film import tiny_film

from datasets.files.errors import SceneError
from datasets.settings import SceneConfig
from datasets.source import open_source
from datasets.validation import hold_out_every, hold_out_outermost, hold_out_poses


@pytest.mark.parametrize("every", [2, 3, 8])
def test_hold_out_every_splits_training_views(every):
    scene = tiny_scene(views=17)
    split = hold_out_every(scene, every)
    names = [view.name for view in split.train + split.test]
    assert sorted(names) == sorted(view.name for view in scene.train)
    assert len(names) == len(set(names))
    assert len(split.test) == len(range(every // 2, 17, every))
    ending = {2: "nd", 3: "rd", 8: "th"}[every]
    assert split.test_split == f"every {every}{ending} of the training views (validation)"


def test_hold_out_outermost():
    scene = tiny_scene(views=16)  # four poses on an arc, symmetric about its middle
    split = hold_out_outermost(scene, 2)
    assert len(split.test) == 8 and len(split.train) == 8
    assert split.test_split == "the 8 outermost of the training views (validation)"
    angles = [abs(view.camera.world_to_cam[2, 0]) for view in split.test + split.train]
    assert min(angles[:8]) > max(angles[8:])


def test_hold_out_poses_of_static_cameras():
    film = tiny_film(frames=5)  # three cameras
    split = hold_out_poses(film, 2)
    assert {view.name[:11] for view in split.test} == {"train/cam02"}
    assert len(split.test) == 5 and len(split.train) == 10


def test_hold_out_poses_of_a_moving_camera():
    scene = tiny_scene(views=4)  # four poses
    assert hold_out_poses(scene, 4) == hold_out_every(scene, 4)


def test_too_few_views_are_refused():
    with pytest.raises(SceneError, match="scene.validation_every: expected at most the 3 training views, found 8"):
        hold_out_every(tiny_scene(views=3), 8)


def test_the_outermost_views_need_a_number():
    with pytest.raises(ValueError, match="scene.validation_outermost: expected true only with scene.validation_every"):
        SceneConfig(validation_outermost=True)
    SceneConfig(validation_outermost=True, validation_every=8)


def test_validation_every_is_refused_for_videos(tmp_path):
    film = SceneConfig(name="synthetic/counter", reader="synthetic", validation_every=8, cache=str(tmp_path / "cache"))
    with pytest.raises(SceneError, match="scene.validation_every: expected 0 for .* synthetic/counter .*found 8"):
        open_source(film)
    assert not (tmp_path / "cache").exists()  # refused before rendering


@pytest.mark.parametrize("videos", [1, 2])
def test_validation_every_is_refused_for_clips(videos, tmp_path):
    for number in range(videos):
        (tmp_path / f"{number}.mp4").touch()
    clip = SceneConfig("video", "video", str(tmp_path), validation_every=8, moving_cameras=True)
    with pytest.raises(SceneError, match="scene.validation_every: expected 0 for clips .*found 8"):
        open_source(clip)  # before the videos are opened
