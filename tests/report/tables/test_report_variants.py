"""Names of runs with different settings: from recorded overrides, or from a comparison of settings."""

from __future__ import annotations

from pathlib import Path

import pytest
from report_runs import write_run

from pipeline.runs.read.collect import collect
from pipeline.runs.read.variants import name_variants


def names(root: Path) -> list[str]:
    return sorted(name_variants(collect(root)).runs["train"])


@pytest.mark.parametrize(
    "overrides, name",
    [
        ((), "fast"),
        (("train=paper",), "fast"),  # metrics.json has the schedule's name
        (("train.densify.max_gaussians=50000",), "fast (densify.max_gaussians=50000)"),
        (("+train.dropout=0.1",), "fast (dropout=0.1)"),
        # In one order, whatever that of the command
        (("train.iterations=600", "scene.frames=30"), "fast (scene.frames=30, iterations=600)"),
        (("scene.frames=30", "train.iterations=600"), "fast (scene.frames=30, iterations=600)"),
        (("train.checkpoint_every=10", "scene.cache=/tmp/x", "threads=1"), "fast"),  # without effect on the result
        # Keys that have been renamed since
        (("train.rate.means=0.1",), "fast (lr.means=0.1)"),
        (("train.densify.leave_out=0.1",), "fast (densify.prune_sensitivity=0.1)"),
    ],
)
def test_recorded_overrides_are_in_the_name(tmp_path: Path, overrides: tuple[str, ...], name: str) -> None:
    write_run(tmp_path, "synthetic/wheel", overrides=overrides)
    assert names(tmp_path) == [name]


def test_without_recorded_overrides_settings_are_compared(tmp_path: Path) -> None:
    """environment.json of an older run has only the shell command, which is not parsed."""
    for seed in range(3):
        folder = write_run(
            tmp_path, "synthetic/wheel", seed=seed, iterations=600 if seed == 2 else 1000, overrides=None
        )
        path = folder / "environment.json"
        path.write_text(path.read_text().replace("seed=", "train.iterations=600 seed="))
    assert names(tmp_path) == ["fast", "fast", "fast (iterations=600)"]


def test_differing_keys_are_named_as_today(tmp_path: Path) -> None:
    for seed in range(3):
        rate = 0.2 if seed == 2 else 0.1
        write_run(tmp_path, "synthetic/wheel", seed=seed, settings=f"  rate:\n    means: {rate}\n", overrides=None)
    assert names(tmp_path) == ["fast", "fast", "fast (lr.means=0.2)"]


def test_more_than_three_differing_keys_are_counted(tmp_path: Path) -> None:
    for seed in range(3):
        settings = "".join(f"  {key}: {seed // 2}\n" for key in "abcde")
        write_run(tmp_path, "synthetic/wheel", seed=seed, settings=settings)
    assert names(tmp_path) == ["fast", "fast", "fast (a=1, b=1, c=1, 2 more)"]


def test_runs_with_different_settings_are_not_averaged(tmp_path: Path) -> None:
    write_run(tmp_path, "synthetic/wheel", seed=0)
    write_run(tmp_path, "synthetic/wheel", seed=1)
    write_run(tmp_path, "synthetic/wheel", seed=2, iterations=600)
    assert names(tmp_path) == ["fast", "fast", "fast (iterations=600)"]


def test_runs_that_differ_only_in_keys_that_are_not_named_stay_apart(tmp_path: Path) -> None:
    for scene in ("synthetic/wheel", "synthetic/lamp"):
        for seed in range(5):
            values = (0, 0, 0, 0) if seed < 3 else (1, 1, 1, seed)  # the fourth of them differs in the last two
            settings = "".join(f"  {key}: {value}\n" for key, value in zip("abcd", values))
            write_run(tmp_path, scene, seed=seed, settings=settings)
    found = names(tmp_path)
    assert found[:6] == ["fast"] * 6
    assert all(name.startswith("fast (a=1, b=1, c=1, 1 more, variant ") for name in found[6:])
    assert found[6] == found[7] != found[8] == found[9], "one name on both scenes"
