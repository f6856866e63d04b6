"""Old names of keys: old run folders open, old commands end with the new name, hashes of stages stay."""

from __future__ import annotations

import hashlib
from dataclasses import asdict
from functools import reduce
from operator import getitem

import pytest
from omegaconf import OmegaConf

from pipeline.config.compose import config_of_tree, known_keys, one_line
from pipeline.config.renamed_keys import (
    ADDED,
    REMOVED,
    RENAMED,
    _leaves,
    renamed_key,
    with_first_names,
    with_renamed_keys,
)
from pipeline.config.schema import Config
from pipeline.config.train_schema import RegularizationConfig, TrainConfig

# As version 0.1 wrote it.
OLD = """
background: sphere
train:
  rate: {mean: 0.5, hold: 0.7, environment: 0.1}
  prior: {motion: 0.01}
  densify: {leave_out: 0.003, leave_out_every: 250, every: 100}
  trial: 0.1
  environment_height: 40
  where_still: {init_points: 9, rate: {sh_rest: 0.001}, densify: {leave_out: 0}}
"""


def test_an_old_configuration_opens_under_the_new_keys() -> None:
    cfg = config_of_tree(with_renamed_keys(OmegaConf.to_container(OmegaConf.create(OLD))))
    assert (cfg.background_model, cfg.train.lr.mean, cfg.train.lr.decay_start) == ("sphere", 0.5, 0.7)
    assert (cfg.train.lr.environment_map, cfg.train.regularization.motion, cfg.train.envmap_height) == (0.1, 0.01, 40)
    assert (cfg.train.densify.prune_sensitivity, cfg.train.densify.prune_sensitivity_every) == (0.003, 250)
    assert (cfg.train.densify.every, cfg.train.select_time_colour) == (100, 0.1)
    assert cfg.train.static_overrides == {
        "init_points": 9,
        "lr": {"sh_rest": 0.001},
        "densify": {"prune_sensitivity": 0},
    }


def test_todays_configuration_stays_as_it_is_and_first_names_come_back() -> None:
    tree = asdict(Config())
    assert with_renamed_keys(tree) == tree
    old = with_first_names(tree)
    assert {"rate", "prior", "trial", "where_still", "environment_until"} <= old["train"].keys()
    assert old["train"]["rate"].keys() >= {"hold", "environment", "mean"} and "background" in old
    for key in ADDED:
        *groups, name = key.split(".")
        del reduce(getitem, groups, tree)[name]
    assert tree["train"].pop("depth") == {}, "a group of added keys only"
    assert "leave_out" in old["train"]["densify"] and with_renamed_keys(old) == tree


@pytest.mark.parametrize("old", RENAMED)
def test_an_old_key_is_refused_with_its_new_name(old: str) -> None:
    assert renamed_key(old) in known_keys() and old not in known_keys()
    with pytest.raises(Exception) as error:
        config_of_tree(OmegaConf.to_container(OmegaConf.from_dotlist([f"{old}=1"])))
    assert renamed_key(old) in one_line(error.value)


def test_a_removed_key_is_dropped_where_it_changed_nothing_and_else_refused() -> None:
    assert with_renamed_keys({"train": {"prior": {"color": 0.0, "motion": 1.0}}}) == {
        "train": {"regularization": {"motion": 1.0}}
    }
    assert with_first_names(asdict(Config()))["train"]["prior"]["color"] == 0.0  # part of the hashes of stages
    for key in REMOVED:
        assert key not in known_keys()
        with pytest.raises(Exception) as error:
            config_of_tree(with_renamed_keys(OmegaConf.to_container(OmegaConf.from_dotlist([f"{key}=0.5"]))))
        assert f"{key}: was removed" in one_line(error.value)


@pytest.mark.parametrize("name", ["flow", "reference_views", "rigid"])
def test_an_added_key_is_part_of_the_hashes_of_stages_only_where_it_changes_something(name: str) -> None:
    nothing = ADDED[f"train.regularization.{name}"]
    assert getattr(RegularizationConfig(), name) == nothing
    for value, expected in ((nothing, None), (0.5, 0.5)):
        cfg = Config(train=TrainConfig(regularization=RegularizationConfig(**{name: value})))
        assert with_first_names(asdict(cfg))["train"]["prior"].get(name) == expected


@pytest.mark.parametrize("tree", [{}, {"model": "resnet"}, {"train": 3}, {"a.b": 1}, {"background": {"x": 1}}])
def test_other_trees_survive(tree: dict) -> None:
    assert isinstance(with_renamed_keys(tree), dict)


def test_a_new_key_is_among_those_added() -> None:
    """The keys that the hashes of stages have known from the first on. A key that this counts too belongs in ADDED."""
    names = sorted(name for name, _ in _leaves(with_first_names(asdict(Config())), ""))
    assert (len(names), hashlib.sha256(" ".join(names).encode()).hexdigest()[:8]) == (131, "e95e3ce4")
