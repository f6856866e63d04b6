"""Several experiments on one command line: their runs are one list for one launcher."""

from __future__ import annotations

from pathlib import Path

import pytest
from omegaconf import DictConfig

from pipeline import cli
from pipeline.config.compose import CONFIG_DIR, register_schema
from pipeline.config.sweep_launch import can_be_one, launch
from pipeline.config.sweep_plan import PlannedRun, merged, planned_sweeps

SMOKE, SUITE, NO_4DROT = ["experiment=smoke"], ["experiment=synthetic_suite"], ["experiment=ablation/no_4drot"]


@pytest.fixture
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # Hydra's folder of a sweep is made here
    register_schema()


@pytest.mark.usefixtures("in_folder")
def test_every_run_is_launched_once_and_a_failed_one_stops_no_other() -> None:
    sweeps = planned_sweeps([[*SMOKE, "ablation=full,no_4dsh"], [*SMOKE, "ablation=no_4dsh,static", "seed=3"]])
    runs = list(merged(sweeps).values())
    begun: list[tuple[str, int, int]] = []

    def task(cfg: DictConfig) -> None:
        begun.append((cfg.ablation.name, cfg.seed, cfg.scene.size))
        if cfg.ablation.name == failing:
            raise ValueError

    failing = "no run"
    assert launch(["-m", *SMOKE, "seed=0,1"], runs, task)  # which runs there are is said by `runs`
    expected = [("full", 0, 48), ("no_4dsh", 0, 48), ("no_4dsh", 3, 48), ("static", 3, 48)]
    assert begun == expected
    failing = "full"
    begun.clear()
    assert not launch(SMOKE, runs, task)
    assert begun == expected


@pytest.mark.parametrize("file", sorted((CONFIG_DIR / "experiment").rglob("*.yaml")), ids=lambda file: file.stem)
def test_the_command_of_each_experiment_is_a_sweep_with_a_folder_for_each_run(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command is the one that the file begins with; DATA_DIR and placeholders are any folder."""
    register_schema()
    monkeypatch.setenv("DATA_DIR", "data")
    command = next(line for line in file.read_text().splitlines() if "python -m pipeline " in line)
    arguments = command.partition("python -m pipeline ")[2].partition("    #")[0].rstrip(" \\").split()
    (runs,) = planned_sweeps([arguments])
    assert len(runs) == len({run.overrides for run in runs.values()}) >= 1
    assert all(out.startswith("results/") and "${" not in out for out in runs)


def test_a_run_of_two_experiments_is_the_first_one_s() -> None:
    register_schema()
    runs = merged(planned_sweeps([SUITE, NO_4DROT]))
    both = runs["results/runs/synthetic/wheel/full/short/seed0"]
    assert SUITE[0] in both.overrides
    assert sum("scene=synthetic/wheel" in run.overrides for run in runs.values()) == 6


SEPARATE = "out=x/${scene.name}/${ablation.name}/${seed}"


def test_two_runs_of_a_sweep_in_one_folder_are_refused() -> None:
    register_schema()
    swept = ["-m", "scene=synthetic/wheel", "train=smoke", "train.batch=2,4", "seed=0,1"]
    with pytest.raises(ValueError, match="synthetic/wheel/full/smoke/seed0 for two that differ in .*batch=2.*batch=4"):
        planned_sweeps([swept])
    (runs,) = planned_sweeps([[*swept, "out=x/${train.batch}/${seed}"]])
    assert sorted(runs) == ["x/2/0", "x/2/1", "x/4/0", "x/4/1"]


@pytest.mark.parametrize(
    "commands, one",
    [
        ([SUITE, NO_4DROT], True),
        ([SUITE], False),
        ([SUITE, SMOKE], False),  # their launchers differ
        ([SUITE, ["scene=synthetic/wheel"]], False),  # the second is a single run
        ([[*SUITE, SEPARATE], [*NO_4DROT, SEPARATE]], False),  # the same folders, which only the first may have
    ],
)
def test_which_commands_can_be_one(commands: list[list[str]], one: bool) -> None:
    register_schema()
    assert can_be_one(commands, planned_sweeps(commands)) is one


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
