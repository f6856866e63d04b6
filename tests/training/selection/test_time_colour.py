"""Selection of time-varying colour: kept where colours change with time, left out where they do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hydra import compose, initialize_config_dir
from tiny import tiny_config, tiny_scene
from tiny_film import tiny_film

from datasets.scene import Scene, View
from pipeline.config.compose import CONFIG_DIR, one_line, register_schema, to_config
from pipeline.config.schema import Config
from pipeline.config.train_schema import LearningRates
from pipeline.training.selection.time_colour import Selection, due, mean_and_error, select, without_time_colour

SHARE = 0.5


def config(iterations: int = 400, **train_keys) -> Config:
    return tiny_config(iterations, select_time_colour=SHARE, **train_keys)


def flickering(scene: Scene) -> Scene:
    """The scene with brightness varying as a cosine of time, the first Fourier order of 4DSH."""

    def at(view: View) -> View:
        brightness = 0.65 + 0.35 * np.cos(2 * np.pi * view.time)
        return replace(view, image=(np.asarray(view.image) * brightness).astype(np.uint8))

    return replace(scene, train=tuple(map(at, scene.train)))


def test_kept_where_colours_change_with_time() -> None:
    """Long-lived Gaussians of constant position and size can fit the brightness only by time-varying colour."""
    views = 48
    still = tiny_scene(views, static=True).train
    scene = replace(tiny_scene(), train=tuple(replace(view, time=i / views) for i, view in enumerate(still)))
    lr = LearningRates(sh_time=1e-2, sh_dc=1e-2, scale=0.0, mean_time=0.0)
    cfg = config(600, fourier_at=[30, 40], init_time_scale=2.0, lr=lr)
    found = select(flickering(scene), cfg, None, 1, str)
    # Measured with three seeds: 4.8 to 6.0 dB, standard error 1.2 dB.
    assert found.kept and found.gain > 2


def test_left_out_where_colours_do_not_change() -> None:
    """Fourier orders activated after the last iteration have no effect: the gain is exactly 0."""
    found = select(tiny_scene(12), config(60, fourier_at=[80, 80]), None, 1, str)
    assert (found.gain, found.standard_error, found.views) == (0.0, 0.0, 3) and not found.kept
    assert found.seconds > 0


def test_the_selection_does_not_use_test_views() -> None:
    scene, cfg, lines = tiny_scene(12), config(60), []
    found = select(scene, cfg, None, 1, lines.append)
    other = select(replace(scene, test=flickering(scene).train), cfg, None, 1, lines.append)
    assert replace(other, seconds=found.seconds) == found
    assert (
        lines[0] == "select_time_colour: with time-varying colour, 30 iterations; 9 training views, 3 validation views"
    )


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


def test_a_gain_must_exceed_its_standard_error_and_the_minimum() -> None:
    assert Selection(0.21, 0.2, 6, 1.0).kept
    assert not Selection(0.19, 0.2, 6, 1.0).kept
    assert Selection(0.11, 0.01, 6, 1.0).kept
    assert not Selection(0.09, 0.01, 6, 1.0).kept
    assert not Selection(-0.3, 0.1, 6, 1.0).kept


def test_when_a_selection_is_due() -> None:
    scene, cfg = tiny_scene(), config()
    assert due(cfg, scene) and due(cfg, tiny_film())
    assert not due(tiny_config(), scene)
    assert not due(without_time_colour(cfg), scene)
    assert not due(cfg, tiny_scene(static=True))
    assert not due(replace(cfg, train=replace(cfg.train, time_budget_s=1.0)), scene)
    assert not due(cfg, replace(scene, train=scene.train[:4]))  # a single validation view
    two = tuple(replace(view, camera=scene.train[i % 2].camera) for i, view in enumerate(scene.train))
    assert not due(cfg, replace(scene, train=two))  # with two poses none can be held out


def test_a_share_out_of_range_is_refused_in_one_line() -> None:
    register_schema()
    with initialize_config_dir(str(CONFIG_DIR), version_base=None), pytest.raises(Exception) as error:
        to_config(compose("config", ["scene=synthetic/wheel", "train=fast", "train.select_time_colour=1"]))
    assert "train.select_time_colour: expected in [0, 1) (0: none), found 1" in one_line(error.value)
