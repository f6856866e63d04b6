"""What the data decide of a configuration: filled in for a scene, once, and found wrong before a scene is read."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from tiny import tiny_scene
from tiny_film import tiny_film, unsynchronised_film

from datasets.settings import SceneConfig
from pipeline.config.compose import CONFIG_DIR, one_line, register_schema, to_config
from pipeline.config.scene_overrides import without_given
from pipeline.config.schema import AblationConfig, Config
from pipeline.config.train_schema import ResolutionStep, TrainConfig
from pipeline.model.scene_settings import overrides_for, resolved
from pipeline.training.selection.motion import without_time

DIFFERENCES = {"init_points": 70, "lr": {"sh_rest": 1e-3}, "resolution_steps": [{"until": 0.5, "scale": 0.5}]}


BLACK = SceneConfig(background="black")


def config(differences: dict | None = DIFFERENCES) -> Config:
    return Config(scene=BLACK, train=TrainConfig(iterations=40, static_overrides=differences))


def test_they_are_put_in_where_nothing_moves() -> None:
    found = resolved(config(), tiny_scene(static=True)).train
    assert (found.init_points, found.lr.sh_rest) == (70, 1e-3)
    assert found.resolution_steps == [ResolutionStep(0.5, 0.5)]  # a whole list, not its items
    plain = config().train
    back = replace(found, init_points=None, lr=plain.lr, resolution_steps=[])
    assert back == replace(
        plain, static_overrides=None, multi_view_overrides=None, clip_overrides=None
    )  # and nothing else


def test_nor_where_something_moves_or_the_schedule_has_none() -> None:
    for scene, cfg in ((tiny_scene(), config()), (tiny_scene(static=True), config(None))):
        black = replace(BLACK, background=[0.0, 0.0, 0.0])
        plain = replace(cfg.train, static_overrides=None, multi_view_overrides=None, clip_overrides=None)
        assert resolved(cfg, scene) == replace(cfg, scene=black, train=plain)


def test_films_have_their_own() -> None:
    one = tiny_scene()
    film = replace(one, capture="multi_view")
    cfg = Config(
        scene=BLACK, train=TrainConfig(iterations=40, multi_view_overrides={"regularization": {"motion": 0.5}})
    )
    assert (resolved(cfg, one).train.regularization.motion, resolved(cfg, film).train.regularization.motion) == (0, 0.5)
    static = replace(tiny_scene(static=True), train=tiny_scene(static=True).train * 2)
    assert resolved(cfg, static).train.regularization.motion == 0


def test_and_clips_by_one_camera() -> None:
    one, film = tiny_scene(), tiny_film()
    clip = replace(one, capture="clip")
    cfg = Config(scene=BLACK, train=TrainConfig(iterations=40, clip_overrides={"dropout": 0.25}))
    found = [resolved(cfg, scene).train.dropout for scene in (one, clip, film)]
    assert found == [0, 0.25, 0]


def test_cameras_that_are_not_synchronised_are_a_multi_view_video() -> None:
    assert overrides_for(unsynchronised_film(), Config()) == "multi_view_overrides"


def test_a_model_that_selection_makes_static_has_the_static_ones() -> None:
    scene, undecided = tiny_scene(), replace(config(), train=replace(config().train, select_motion=0.1))
    once = resolved(undecided, scene)
    assert (once.train.init_points, without_time(once, scene).train.init_points) == (None, 70)
    assert resolved(once, scene) == once


def test_resolving_twice_is_resolving_once() -> None:
    for scene in (tiny_scene(), tiny_scene(static=True)):
        once = resolved(config(), scene)
        assert resolved(once, scene) == once


def test_the_background_is_the_scenes() -> None:
    white = replace(tiny_scene(), background=(1.0, 1.0, 1.0))
    assert resolved(Config(), white).scene.background == [1.0, 1.0, 1.0]


def test_it_is_the_model_that_moves_or_does_not() -> None:
    no_time = replace(config(), ablation=AblationConfig(static=True))
    assert resolved(no_time, tiny_scene()).train.init_points == 70
    time = replace(config(), ablation=AblationConfig(static=False))
    assert resolved(time, tiny_scene(static=True)).train.init_points is None


@pytest.mark.parametrize(
    "override, message",
    [
        ("+train.static_overrides.lr.sh=1", "train.static_overrides.lr.sh: no such key"),
        (
            "train.static_overrides.lr.mean=1",
            "not among this schedule's differences; add it as +train.static_overrides.lr.mean",
        ),
        ("+train.static_overrides.static_overrides.batch=1", "no such key"),
        ("+train.multi_view_overrides.static_overrides.batch=1", "no such key"),
        ("+train.multi_view_overrides.dropout=2", "train.dropout: expected in [0, 1) (0: none), found 2.0"),
        ("train.static_overrides.lr.sh_rest=-1", "train.lr.sh_rest: expected >= 0, found -1"),
        ("train.static_overrides.init_points=many", "train.init_points: Value 'many'"),
    ],
)
def test_a_wrong_one_is_one_line_on_any_scene(override: str, message: str) -> None:
    register_schema()
    with initialize_config_dir(str(CONFIG_DIR), version_base=None), pytest.raises(Exception) as error:
        to_config(compose("config", ["scene=synthetic/wheel", "train=fast", override]))
    line = one_line(error.value)
    assert message in line and "\n" not in line


def test_an_added_one_counts() -> None:
    register_schema()
    with initialize_config_dir(str(CONFIG_DIR), version_base=None):
        cfg = to_config(compose("config", ["scene=synthetic/wheel", "train=fast", "+train.static_overrides.batch=2"]))
    assert resolved(cfg, tiny_scene(static=True)).train.batch == 2
    assert OmegaConf.structured(cfg).train.batch == resolved(cfg, tiny_scene()).train.batch == 4


def test_what_the_command_line_gives_counts_on_every_kind_of_scene() -> None:
    one, static = tiny_scene(), tiny_scene(static=True)
    film = replace(one, capture="multi_view")
    arguments = ["scene=synthetic/wheel", "train=fast", "train.regularization.opacity=0.5", "train.lr={sh_rest: 0.25}"]
    register_schema()
    with initialize_config_dir(str(CONFIG_DIR), version_base=None):
        composed = compose("config", arguments)
    usual, given = to_config(composed), to_config(without_given(composed, arguments))
    for scene in (one, film, static):
        train = resolved(given, scene).train
        assert (train.regularization.opacity, train.lr.sh_rest) == (0.5, 0.25)
        # nothing else changes
        expected = resolved(usual, scene).train
        lr, regularization = replace(expected.lr, sh_rest=0.25), replace(expected.regularization, opacity=0.5)
        assert train == replace(expected, lr=lr, regularization=regularization)


def test_an_override_of_a_kind_of_scene_on_the_command_line_stays() -> None:
    arguments = ["scene=synthetic/wheel", "train=fast", "train.static_overrides.init_points=7"]
    register_schema()
    with initialize_config_dir(str(CONFIG_DIR), version_base=None):
        composed = compose("config", arguments)
    assert resolved(to_config(without_given(composed, arguments)), tiny_scene(static=True)).train.init_points == 7
