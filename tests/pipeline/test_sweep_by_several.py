"""One sweep by several processes at once, as on several machines that share a folder: each run once, none lost, and the
same bits as by one process alone."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest
from shell import TINY, Shell, result

SEEDS = range(4)
SWEEP = ("-m", *TINY, f"seed={','.join(map(str, SEEDS))}", "train.iterations=200", "train.checkpoint_every=20")


def runs(folder: Path) -> list[Path]:
    return [folder / f"results/runs/synthetic/wheel/full/smoke/seed{seed}" for seed in SEEDS]


def finished(run: Path) -> list[str]:
    """The stages that were done, each as often as it was."""
    rows = map(json.loads, (run / "log.jsonl").read_text().splitlines())
    return [row["event"].split()[1] for row in rows if row.get("event", "").startswith("finished ")]


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Shell:
    shell = Shell(tmp_path_factory.mktemp("alone"))
    shell(*SWEEP)
    return shell


def test_three_processes_of_which_one_is_killed(alone: Shell, tmp_path: Path) -> None:
    shell = Shell(tmp_path)
    three = [shell.start(*SWEEP) for _ in range(3)]
    killed: Path | None = None
    while killed is None:
        assert all(process.is_running() for process in three)
        killed = next((run for run in runs(tmp_path) if (run / "checkpoint.safetensors").exists()), None)
        time.sleep(0.01)
    victim = next(process for process in three if process.claims(killed))
    victim.kill()
    for process in three:
        if process is not victim:
            status, _, err = process.wait()
            assert (status, err) == (0, "")
    for run, reference in zip(runs(tmp_path), runs(alone.folder)):
        assert finished(run) == ["prepare", "settle", "init", "train", "evaluate", "page"], "each stage once"
        assert result(run) == result(reference)
