"""Training profile: nested stages by a clock of whole seconds, and the stages of a real training."""

from __future__ import annotations

import csv
import itertools
import time
from pathlib import Path

import pytest

from pipeline.studies.training_profile.__main__ import REST, main
from pipeline.studies.training_profile.stage_clock import StageClock
from pipeline.training import loop


def ticking_clock() -> StageClock:
    """A second passes whenever it is read."""
    return StageClock(itertools.count().__next__)


def test_time_counts_for_the_innermost_stage() -> None:
    clock = ticking_clock()
    with clock.stage("outer"), clock.stage("inner"):
        pass
    assert clock.seconds == {"outer": 2, "inner": 1}


def test_a_whole_stage_has_the_time_of_those_within() -> None:
    clock = ticking_clock()
    with clock.stage("outer"), clock.stage("whole", whole=True), clock.stage("inner"):
        pass
    with clock.stage("inner"):
        pass
    assert clock.seconds == {"outer": 2, "whole": 1, "inner": 1}


def test_an_error_ends_its_stage() -> None:
    clock = ticking_clock()
    with pytest.raises(ArithmeticError), clock.stage("outer"), clock.stage("whole", whole=True):
        raise ArithmeticError
    with clock.stage("after"):
        pass
    assert clock.seconds == {"outer": 2, "whole": 1, "after": 1}


def test_the_stages_of_a_training(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """They add up to less than all CPU time, have the kernel's, and leave the program as it was."""
    before, started = loop.train, time.process_time()
    keys = ["scene=synthetic/wheel", "scene.size=32", "scene.train_views=8", "scene.test_views=2",
            "train=smoke", "train.iterations=12", f"scene.cache={tmp_path}/cache"]  # fmt: skip
    assert main([*keys, "--out", str(tmp_path / "out")]) == 0
    spent = time.process_time() - started
    with (tmp_path / "out/training_profile.csv").open() as file:
        seconds = {row["stage"]: float(row["seconds"]) for row in csv.DictReader(file)}
    assert 0 < sum(seconds.values()) < spent and loop.train is before
    assert {"preprocess", "blend", "blend_backward", "preprocess_backward", "photometric loss", REST} <= set(seconds)
    assert min(seconds.values()) >= 0
    assert (tmp_path / "out/training_profile.md").read_text() in capsys.readouterr().out
