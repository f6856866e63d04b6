"""Selection between static and dynamic: dynamic where the scene changes, static where only the camera moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tiny import tiny_config, tiny_scene

from datasets.scene import Scene, View
from pipeline.config.schema import AblationConfig, Config
from pipeline.training.selection.motion import MotionSelection, due, select_motion, without_time

VIEWS = 24


def config(iterations: int = 400, **train_keys) -> Config:
    return tiny_config(iterations, select_motion=0.5, **train_keys)


def scene(changes: bool) -> Scene:
    """A static scene seen from VIEWS places at as many times; with `changes` it is dark in the second half."""

    def at(view: View, index: int, time: float) -> View:
        world_to_cam = view.camera.world_to_cam.copy()
        world_to_cam[2, 3] += 1e-3 * index  # tiny_scene has four places
        image = (np.asarray(view.image) * (0.1 if changes and time > 0.5 else 1.0)).astype(np.uint8)
        return replace(view, camera=replace(view.camera, world_to_cam=world_to_cam), time=time, image=image)

    views = tiny_scene(VIEWS, static=True).train
    times = (np.random.default_rng(0).permutation(VIEWS) / VIEWS).tolist()  # shuffled: time is not the camera's place
    return replace(tiny_scene(), train=tuple(map(at, views, range(VIEWS), times)))


def test_dynamic_where_the_scene_changes() -> None:
    """A model without time shows the mean of both halves: 45 % of the brightness too much or too little."""
    found = select_motion(scene(changes=True), config(), None, 1, str)
    assert found.dynamic and found.dynamic_psnr - found.static_psnr > 2


def test_static_where_only_the_camera_moves() -> None:
    found = select_motion(scene(changes=False), config(), None, 1, str)
    assert not found.dynamic and found.views == VIEWS // 4


def test_test_views_are_not_used() -> None:
    one, lines = scene(changes=True), []
    cfg = config(40)
    found = select_motion(one, cfg, None, 1, lines.append)
    other = select_motion(replace(one, test=one.train), cfg, None, 1, str)
    assert replace(other, seconds=found.seconds) == found
    assert lines[0] == "select_motion: without time, 20 iterations; 18 training frames, 6 validation frames"


def test_time_must_gain_more_than_two_standard_errors() -> None:
    assert MotionSelection(20.0, 20.5, 0.2, 6, 1.0).dynamic
    assert not MotionSelection(20.0, 20.3, 0.2, 6, 1.0).dynamic
    assert str(MotionSelection(20.0, 20.3, 0.2, 6, 1.0)).startswith("static: on 6 held-out frames")


def test_due_for_one_moving_camera_whose_model_may_have_time() -> None:
    moving, cfg = scene(changes=True), config()
    assert due(cfg, moving)
    assert not due(replace(cfg, train=replace(cfg.train, select_motion=0.0)), moving)
    for static in (True, False):  # the user has decided
        assert not due(replace(cfg, ablation=AblationConfig(static=static)), moving)
    assert not due(replace(cfg, train=replace(cfg.train, time_budget_s=9.0)), moving), "all of it is for the schedule"
    same_place = replace(moving, train=tuple(replace(view, camera=moving.train[0].camera) for view in moving.train))
    assert not due(cfg, same_place), "one camera that stands still, or several: all moments are seen from each place"
    assert not due(cfg, replace(moving, capture="multi_view")), "two cameras that move"


def test_the_static_model_has_no_time() -> None:
    found = without_time(config(), scene(changes=False))
    assert found.ablation.static is True


def test_batches_larger_than_the_part_of_the_views_become_smaller() -> None:
    """18 of the 24 views are trained on."""
    found = select_motion(scene(changes=True), config(8, batch=VIEWS), None, 1, lambda line: None)
    assert found.views == VIEWS // 4
