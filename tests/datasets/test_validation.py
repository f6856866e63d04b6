"""A validation split: every view once, on one side, and never a test view."""

from __future__ import annotations

import pytest
from tiny import tiny_scene
from tiny_film import tiny_film

from datasets import SceneError, load_posed, load_scene
from datasets.settings import SceneConfig
from datasets.validation import hold_out_every, hold_out_outermost, hold_out_poses


@pytest.mark.parametrize("every", [2, 3, 8])
def test_training_views_are_parted(every):
    scene = tiny_scene(views=17)
    split = hold_out_every(scene, every)
    names = [view.name for view in split.train + split.test]
    assert sorted(names) == sorted(view.name for view in scene.train)
    assert len(names) == len(set(names))
    assert len(split.test) == len(range(every // 2, 17, every))


def test_the_outermost_look_from_the_ends_of_the_arc():
    scene = tiny_scene(views=16)  # four places on an arc, the outer two as far from its middle as each other
    split = hold_out_outermost(scene, 2)
    assert len(split.test) == 8 and len(split.train) == 8
    turned = [abs(view.camera.world_to_cam[2, 0]) for view in split.test + split.train]
    assert min(turned[:8]) > max(turned[8:])


def test_whole_cameras_are_held_out():
    film = tiny_film(frames=5)  # three cameras
    split = hold_out_poses(film, 2)
    assert {view.name[:11] for view in split.test} == {"train/cam02"}
    assert len(split.test) == 5 and len(split.train) == 10


def test_a_moving_camera_has_a_pose_a_view():
    scene = tiny_scene(views=4)  # as many places
    assert hold_out_poses(scene, 4) == hold_out_every(scene, 4)


def test_too_few_views():
    with pytest.raises(SceneError, match="scene.validation_every: expected at most the 3 training views, found 8"):
        hold_out_every(tiny_scene(views=3), 8)


@pytest.mark.parametrize("load", [load_scene, load_posed])
def test_of_films_cameras_are_held_out_not_every_so_many_th_view(load, tmp_path):
    film = SceneConfig(name="synthetic/counter", reader="synthetic", validation_every=8, cache=str(tmp_path / "cache"))
    with pytest.raises(SceneError, match="scene.validation_every: expected 0 for synthetic/counter.*found 8"):
        load(film)
    assert not (tmp_path / "cache").exists()  # found before anything is filmed
