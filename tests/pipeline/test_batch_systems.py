"""What batch systems do to runs: several at one sweep, commands listed for others, signals. Each run is made once,
none is lost, and all have the same bits as by one process alone."""

from __future__ import annotations

import json
import shlex
import signal
import time
from pathlib import Path

import pytest
from shell import TINY, Shell, result

from datasets.files.claim import Claim
from pipeline.terminal.interruption import AGAIN
from pipeline.training.checkpoint import saved_iteration

SEEDS = range(4)
LONGER = (*TINY, "train.iterations=200", "train.checkpoint_every=20")
SWEEP = (*LONGER, f"seed={','.join(map(str, SEEDS))}")


def runs(folder: Path) -> list[Path]:
    return [folder / f"results/runs/synthetic/wheel/full/smoke/seed{seed}" for seed in SEEDS]


def finished(run: Path) -> list[str]:
    """The stages that were done, each as often as it was."""
    rows = map(json.loads, (run / "log.jsonl").read_text().splitlines())
    return [row["event"].split()[1] for row in rows if row.get("event", "").startswith("finished ")]


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Shell:
    shell = Shell(tmp_path_factory.mktemp("alone"))
    shell("-m", *SWEEP)
    return shell


def test_three_processes_of_which_one_is_killed(alone: Shell, tmp_path: Path) -> None:
    shell = Shell(tmp_path)
    three = [shell.start("-m", *SWEEP) for _ in range(3)]
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


def test_listed_commands_are_the_runs_of_the_sweep_and_may_be_repeated(alone: Shell, tmp_path: Path) -> None:
    shell = Shell(tmp_path)
    lines = {until: shell("--list", *SWEEP, *until)[0].splitlines() for until in ((), ("until=init",))}
    assert not list(tmp_path.iterdir()), "nothing is run"
    first, last = runs(tmp_path)[0], runs(tmp_path)[-1]
    for line, run in ((lines[()][-1], last), (lines["until=init",][0], first)):
        command = shlex.split(line)
        assert command[1:3] == ["-m", "pipeline"] and len(lines[()]) == len(SEEDS)
        shell(*command[3:])
        assert "already done" in shell(*command[3:])[0]
        assert run.exists()
    assert finished(first) == ["prepare", "settle", "init"]
    assert finished(last)[-1] == "page" and result(last) == result(runs(alone.folder)[-1])


def test_a_run_that_another_process_is_at_work_on_is_to_be_tried_again(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    with Claim(tmp_path / "run"):
        _, err = Shell(tmp_path)(*TINY, "out=run", status=AGAIN)
    assert err.startswith("error: run: expected a free run folder, found another process at work in it (")


@pytest.mark.parametrize("signum", [signal.SIGTERM, signal.SIGUSR2])
def test_a_signal_of_a_batch_system_saves_the_training_and_asks_for_the_command_again(
    alone: Shell, tmp_path: Path, signum: signal.Signals
) -> None:
    shell, run = Shell(tmp_path), tmp_path / "run"
    arguments = (*LONGER, "train.checkpoint_every=1000", "out=run")  # none but the one at the signal
    command = shell.start(*arguments)
    while "10/200" not in command.said():
        assert command.is_running(), command.wait()
        time.sleep(0.01)
    command.interrupt(signum)
    status, _, err = command.wait()
    iteration = saved_iteration(run / "checkpoint.safetensors")
    assert (status, err) == (AGAIN, f"error: interrupted; the same command goes on from iteration {iteration}\n")
    assert 10 <= iteration < 200
    shell(*arguments)
    assert result(run) == result(runs(alone.folder)[0])
