"""Several experiments on one command line: their runs are one list for one launcher."""

from __future__ import annotations

from pathlib import Path

import pytest
from omegaconf import DictConfig

from pipeline import cli
from pipeline.config.compose import register_schema
from pipeline.config.sweep_launch import have_one_launcher, launch
from pipeline.config.sweep_plan import PlannedRun, planned_runs

SMOKE, SUITE = ["experiment=smoke"], ["experiment=synthetic_suite"]


@pytest.fixture
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # Hydra's folder of a sweep is made here
    register_schema()


@pytest.mark.usefixtures("in_folder")
def test_every_run_is_launched_once_and_a_failed_one_stops_no_other() -> None:
    runs = list(
        planned_runs([[*SMOKE, "ablation=full,no_4dsh"], [*SMOKE, "ablation=no_4dsh,static", "seed=3"]]).values()
    )
    begun: list[tuple[str, int, int]] = []

    def task(cfg: DictConfig) -> None:
        begun.append((cfg.ablation.name, cfg.seed, cfg.scene.size))
        if cfg.ablation.name == failing:
            raise ValueError

    failing = "no run"
    assert launch(SMOKE, runs, task)
    expected = [("full", 0, 48), ("no_4dsh", 0, 48), ("no_4dsh", 3, 48), ("static", 3, 48)]
    assert begun == expected
    failing = "full"
    begun.clear()
    assert not launch(SMOKE, runs, task)
    assert begun == expected


def test_a_run_of_two_experiments_is_the_first_one_s() -> None:
    register_schema()
    runs = planned_runs([SUITE, ["experiment=ablation/no_4drot"]])
    both = runs["results/runs/synthetic/wheel/full/short/seed0"]
    assert SUITE[0] in both.overrides
    assert sum("scene=synthetic/wheel" in run.overrides for run in runs.values()) == 6


def test_experiments_of_two_launchers_have_none_in_common() -> None:
    register_schema()
    assert have_one_launcher(list(planned_runs([SUITE, ["experiment=ablation/no_4dsh"]]).values()))
    assert not have_one_launcher(list(planned_runs([SUITE, SMOKE]).values()))
    assert not have_one_launcher(list[PlannedRun]())


def test_an_interrupted_sweep_says_what_is_kept(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(command: list[str], runs: list[PlannedRun], task: object) -> bool:
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "launch", interrupted)
    monkeypatch.setattr("sys.argv", ["pipeline", "experiment=ablation/no_4drot,ablation/no_4dsh"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 130
    said = capsys.readouterr().err
    assert said == "error: interrupted; finished runs are kept, and the same command goes on with the others\n"
