"""The recipe "add an ablation": one file in conf/ablation, and it can be chosen, trained and told apart."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from tiny import tiny_scene

import pipeline.config.compose as composition
from pipeline.config.random_streams import Stream, stream
from pipeline.data.prepare import Prepared
from pipeline.model.initialise import initialise
from pipeline.stages.settle import changes, for_scene


def test_a_toy_ablation_is_one_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    conf = shutil.copytree(composition.CONFIG_DIR, tmp_path / "conf")
    (conf / "ablation/toy.yaml").write_text("name: toy\nsh_degree: 0  # no view-dependent colour\n")
    monkeypatch.setattr(composition, "CONFIG_DIR", conf)
    order = composition.Command(("scene=synthetic/wheel", "train=smoke", "ablation=toy"))
    data = Prepared(tiny_scene(), None, None)
    cfg = for_scene(order, data, {})
    assert cfg.out.endswith("synthetic/wheel/toy/smoke/seed0") and "toy" in composition.options("ablation")
    assert initialise(data.scene, cfg, stream(0, Stream.INIT)).kind.sh_degree == 0
    assert changes(order, data.scene) == {}, "it is the model, not a change of it"
