"""Decisions by validation: time and time-varying colour are kept where the scene needs them, and left out elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tiny import tiny_config, tiny_scene
from tiny_film import tiny_film

from datasets.scene import Scene, View
from pipeline.config.compose import Command
from pipeline.config.schema import AblationConfig, Config
from pipeline.config.train_schema import LearningRates
from pipeline.data.prepare import Prepared
from pipeline.evaluation.rivals import AgainstRivals
from pipeline.stages import decide, settle
from pipeline.stages.decide import (
    Comparison,
    colour_is_open,
    compare_colour,
    compare_shared_motion,
    compare_time,
    mean_and_error,
    motion_scale,
    shared_motion_is_open,
    time_is_open,
    without_time_colour,
)
from pipeline.training import schedule

VIEWS = 24


def config(iterations: int = 400, **train_keys) -> Config:
    cfg = tiny_config(iterations, **{"select": True, **train_keys})
    return replace(cfg, scene=replace(cfg.scene, may_be_static=True), threads=1)


def silent(line: str) -> None:
    pass


def one_camera(changes: bool) -> Scene:
    """A static scene seen from VIEWS places at as many times; with `changes` it is dark in the second half."""

    def at(view: View, index: int, time: float) -> View:
        world_to_cam = view.camera.world_to_cam.copy()
        world_to_cam[2, 3] += 1e-3 * index  # tiny_scene has four places
        image = (np.asarray(view.image) * (0.1 if changes and time > 0.5 else 1.0)).astype(np.uint8)
        return replace(view, camera=replace(view.camera, world_to_cam=world_to_cam), time=time, image=image)

    views = tiny_scene(VIEWS, static=True).train
    times = (np.random.default_rng(0).permutation(VIEWS) / VIEWS).tolist()  # shuffled: time is not the camera's place
    return replace(tiny_scene(), train=tuple(map(at, views, range(VIEWS), times)))


def flickering(scene: Scene) -> Scene:
    """The scene with brightness varying as a cosine of time, the first Fourier order of 4DSH."""

    def at(view: View) -> View:
        brightness = 0.65 + 0.35 * np.cos(2 * np.pi * view.time)
        return replace(view, image=(np.asarray(view.image) * brightness).astype(np.uint8))

    return replace(scene, train=tuple(map(at, scene.train)))


def test_time_is_kept_where_the_scene_changes() -> None:
    """A model without time shows the mean of both halves: 45 % of the brightness too much or too little."""
    found = compare_time(config(), one_camera(changes=True), None, silent)
    assert found.beyond_chance and found.psnr_with - found.psnr_without > 2


def test_time_is_left_out_where_only_the_camera_moves() -> None:
    found = compare_time(config(), one_camera(changes=False), None, silent)
    assert not found.beyond_chance and found.views == VIEWS // 4


def test_time_varying_colour_is_kept_where_colours_change(monkeypatch: pytest.MonkeyPatch) -> None:
    """Long-lived Gaussians of constant position and size can fit the brightness only by time-varying colour."""
    views = 48
    still = tiny_scene(views, static=True).train
    scene = replace(tiny_scene(), train=tuple(replace(view, time=i / views) for i, view in enumerate(still)))
    monkeypatch.setattr(schedule, "SCALE_RATE", 0.0)
    monkeypatch.setattr(decide, "COLOUR_SHARE", 0.5)
    lr = LearningRates(sh_time=1e-2, factor=4)
    found = compare_colour(config(600, init_time_scale=2.0, lr=lr), flickering(scene), None, silent)
    assert found.keeps_colour and found.gain > 2  # three seeds: 4.8 to 6.0 dB, standard error 1.2 dB


def test_time_varying_colour_is_left_out_where_it_gains_nothing() -> None:
    """Fourier orders that begin after the last iteration have no effect: the gain is exactly 0."""
    found = compare_colour(config(60, orders_at=[15, 30, 45, 80, 80]), tiny_scene(12), None, silent)
    assert (found.gain, found.standard_error, found.views) == (0.0, 0.0, 3) and not found.keeps_colour


@pytest.mark.parametrize("compare, scene", [(compare_time, one_camera(changes=True)), (compare_colour, tiny_scene(12))])
def test_test_views_are_not_used(compare, scene: Scene) -> None:
    lines: list[str] = []
    found = compare(config(40), scene, None, lines.append)
    other = compare(config(40), replace(scene, test=flickering(scene).train), None, silent)
    assert (
        replace(other, seconds=found.seconds, cpu_seconds=found.cpu_seconds) == found
        and min(found.seconds, found.cpu_seconds) > 0
    )
    views = len(scene.train)
    assert lines[0].endswith(f"40 iterations; {3 * views // 4} training views, {views // 4} validation views")


def test_batches_larger_than_the_part_of_the_views_become_smaller() -> None:
    """18 of the 24 views are trained on."""
    assert compare_time(config(8, batch=VIEWS), one_camera(changes=True), None, silent).views == 6


def compared(gain: float, error: float, fit_gain: float = 0.0) -> Comparison:
    return Comparison(20.0 + gain, 20.0, gain, error, fit_gain, AgainstRivals(20.0, 12.0, 14.0), 6, 1.0, 2.0)


def test_time_must_gain_more_than_two_standard_errors() -> None:
    assert compared(0.5, 0.2).beyond_chance and not compared(0.3, 0.2).beyond_chance


def test_colour_must_gain_more_than_its_standard_error_and_the_minimum() -> None:
    kept = [compared(*found).keeps_colour for found in ((0.21, 0.2), (0.11, 0.01))]
    left_out = [compared(*found).keeps_colour for found in ((0.19, 0.2), (0.09, 0.01), (-0.3, 0.1))]
    assert all(kept) and not any(left_out)


def test_colour_that_explains_the_training_views_may_gain_less() -> None:
    assert compared(0.09, 0.12, fit_gain=1.7).keeps_colour
    assert not compared(0.09, 0.12, fit_gain=0.8).keeps_colour and not compared(-0.01, 0.12, fit_gain=1.7).keeps_colour


@pytest.mark.parametrize(
    "gains, poses, mean, error",
    [
        ([1.0, 3.0], "ab", 2.0, 1.0),  # √(2 / 2)
        ([1.0, 1.0, 1.0, 3.0], "aaab", 2.0, 1.0),  # one sample per pose, for any number of views
        ([1.0, 3.0], "aa", 2.0, 1.0),  # over frames with a single pose
    ],
)
def test_the_standard_error_is_over_poses(gains: list[float], poses: str, mean: float, error: float) -> None:
    assert mean_and_error(np.array(gains), poses) == (mean, error)


def test_time_is_open_for_one_moving_camera_whose_model_may_have_it() -> None:
    moving, cfg = one_camera(changes=True), config()
    assert time_is_open(cfg, moving)
    assert not time_is_open(replace(cfg, scene=replace(cfg.scene, may_be_static=False)), moving)
    for static in (True, False):  # the user has decided
        assert not time_is_open(replace(cfg, ablation=AblationConfig(static=static)), moving)
    assert not time_is_open(replace(cfg, train=replace(cfg.train, time_budget_s=9.0)), moving), "for the schedule alone"
    same_place = replace(moving, train=tuple(replace(view, camera=moving.train[0].camera) for view in moving.train))
    assert not time_is_open(cfg, same_place), "a camera that stands still sees all moments from one place"
    assert not time_is_open(cfg, replace(moving, capture="multi_view")), "two cameras that move"


def test_colour_is_open_where_the_model_has_it() -> None:
    scene, cfg = tiny_scene(), config()
    assert colour_is_open(cfg, scene) and colour_is_open(cfg, tiny_film())
    assert not colour_is_open(tiny_config(), scene)
    assert not colour_is_open(without_time_colour(cfg), scene)
    assert not colour_is_open(cfg, tiny_scene(static=True))
    assert not colour_is_open(replace(cfg, train=replace(cfg.train, time_budget_s=1.0)), scene)
    assert not colour_is_open(cfg, replace(scene, train=scene.train[:4])), "a single validation view"
    two = tuple(replace(view, camera=scene.train[i % 2].camera) for i, view in enumerate(scene.train))
    assert not colour_is_open(cfg, replace(scene, train=two)), "with two poses none can be held out"


def test_shared_motion_must_gain_on_training_views_and_on_others() -> None:
    gains = {(2.0, 1.1): True, (1.1, 2.0): True, (0.9, 2.0): False, (2.0, 0.9): False, (-1.3, 3.0): False}
    for (held_out, fit), taken in gains.items():
        assert replace(compared(held_out, 0.2), fit_gain=fit).takes_shared_motion == taken


def test_shared_motion_is_open_for_one_camera_that_films_from_everywhere() -> None:
    few, cfg = replace(one_camera(changes=True), capture="monocular"), config()
    scene = replace(few, train=4 * few.train)
    assert shared_motion_is_open(cfg, scene)
    assert not shared_motion_is_open(cfg, replace(few, train=3 * few.train)), "72 views are too few"
    assert not shared_motion_is_open(config(select=False), scene)
    for capture in ("clip", "multi_view", "drive", "static"):
        assert not shared_motion_is_open(cfg, replace(scene, capture=capture)), capture
    for ablation in (
        AblationConfig(shared_motion=False),
        AblationConfig(rotation_4d=False),
        AblationConfig(static=True),
    ):
        assert not shared_motion_is_open(replace(cfg, ablation=ablation), scene), ablation
    assert not shared_motion_is_open(replace(cfg, train=replace(cfg.train, time_budget_s=9.0)), scene)


def test_shared_motion_is_compared_by_its_own_settings() -> None:
    """Both without colours that change in time, in as many iterations; the same comparison twice."""
    scene, lines = one_camera(changes=True), []
    shared = config(60, motion="trajectories", init_time_scale=1000)
    found, again = (compare_shared_motion(config(60), shared, scene, None, lines.append) for _ in range(2))
    assert replace(again, seconds=found.seconds, cpu_seconds=found.cpu_seconds) == found and found.views == VIEWS // 4
    assert lines[0].startswith("settle: with shared motion, 60 iterations") and "60 iterations" in lines[1]


@pytest.mark.parametrize(("width", "scale", "side"), [(400, 1, 100), (1352, 0.5, 100), (160, 1, 80), (320, 0.5, 80)])
def test_shared_motion_is_compared_at_100_pixels_or_at_half(width: int, scale: float, side: int) -> None:
    """scale: the schedule's own resolution, of which half is the most."""
    scene = tiny_scene()
    larger = [replace(view, camera=view.camera.resized(width, width // 2)) for view in scene.train]
    compared = motion_scale(replace(scene, train=tuple(larger)), scale)
    assert width * scale * compared == pytest.approx(side)


@pytest.mark.parametrize("model, static, kept", [(20.0, True, "static: time,"), (14.9, False, "dynamic by default, ")])
def test_of_two_blurs_the_default_is_taken(
    model: float, static: bool, kept: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    against, lines = AgainstRivals(model, 30.0, 14.0), []
    monkeypatch.setattr(settle, "compare_time", lambda *args: replace(compared(-0.5, 0.2), against=against))
    command = Command(("scene=synthetic/wheel", "scene.may_be_static=true", "train.select=false"))
    found = settle.decide(command, Prepared(one_camera(changes=True), None, None), lines.append)
    assert found["decided"] == {"static": static} and lines[-1].startswith(f"settle: {kept}")
