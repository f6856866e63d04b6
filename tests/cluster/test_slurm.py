"""Sweeps on a real Slurm of this machine: every run once, none lost, the same bits as by one process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from engines import SEEDS, Place, place, recipe, small_disk, sweep, until

pytestmark = pytest.mark.cluster
LONG = 400  # iterations, some seconds, in which something can happen
LONGER = 1500  # more than the 15 s of a job in the test of a time-out


@pytest.fixture()
def here(slurm: Path, tmp_path: Path) -> Place:
    return place(tmp_path / "work", SLURM_CONF=str(slurm))


def launched(iterations: int, *more: str) -> list[str]:
    resources = ["hydra.launcher.cpus_per_task=1", "hydra.launcher.mem_gb=1", "hydra.launcher.timeout_min=10"]
    return [sys.executable, "-m", "pipeline", "-m", "launcher=slurm", *resources, *more, *sweep(iterations)]


def job_of(worker: int) -> str:
    """The Slurm job that a process belongs to."""
    words = Path(f"/proc/{worker}/environ").read_bytes().split(b"\0")
    return next(word.split(b"=")[1].decode() for word in words if word.startswith(b"SLURM_JOB_ID="))


def told(here: Place, *command: str) -> str:
    return subprocess.run(
        command, cwd=here.folder, env=here.environment, capture_output=True, text=True, check=True
    ).stdout


def restarts(here: Place, job: str) -> int:
    words = told(here, "scontrol", "show", "job", "--oneliner", job).split()
    return int(next(word for word in words if word.startswith("Restarts=")).split("=")[1])


@pytest.mark.parametrize("command", ["scancel --signal=TERM", "scancel --signal=USR2", "scontrol requeue", "kill -9"])
def test_a_job_that_is_stopped_goes_on(here: Place, alone: Callable[[int], Place], command: str) -> None:
    """By a signal, by the administrator, and by the kernel, which kills what takes too much memory."""
    driver = here.start(*launched(LONG))
    worker = here.worker(1, driver)
    job = job_of(worker)
    if command == "kill -9":
        os.kill(worker, signal.SIGKILL)
    else:
        told(here, *command.split(), job)
    here.wait(driver)
    assert restarts(here, job) == 1
    here.assert_as_alone(alone(LONG))


def test_a_run_that_needs_longer_than_a_job_may(here: Place, alone: Callable[[int], Place]) -> None:
    """Slurm counts in minutes; here it signals 15 s after the start."""
    driver = here.start(*launched(LONGER, "hydra.launcher.timeout_min=1", "hydra.launcher.signal_delay_s=45"))
    job = job_of(here.worker(0, driver))
    here.wait(driver)
    assert restarts(here, job) >= 1
    here.assert_as_alone(alone(LONGER))


def test_a_full_disk(here: Place, alone: Callable[[int], Place]) -> None:
    with small_disk(here.folder / "results", megabytes=30):
        (ballast := here.folder / "results/ballast").write_bytes(bytes(29 * 2**20))
        said = here(*launched(LONG, "hydra.launcher.submitit_folder=jobs"), status=1)
        logs = "".join(path.read_text() for path in (here.folder / "jobs").glob("*.err"))
        assert "found no space left" in logs + said and "Traceback" not in logs + said
        ballast.unlink()
        here(*launched(LONG, "hydra.launcher.submitit_folder=jobs"))
        here.assert_as_alone(alone(LONG))


def test_an_array_of_listed_commands(here: Place, alone: Callable[[int], Place]) -> None:
    """The recipe of docs/machines.md; one job is told that its time is over, another one's worker is killed."""
    lines = told(here, sys.executable, "-m", "pipeline", "--list", *sweep(LONG))
    (here.folder / "runs.txt").write_text(lines)
    (here.folder / "array.sh").write_text(recipe("array.sh"))
    told(here, "sbatch", f"--array=1-{len(SEEDS)}", "--mem=1G", "array.sh")
    told(here, "scancel", "--signal=USR2", job_of(here.worker(0)))
    os.kill(here.worker(1), signal.SIGKILL)
    until(lambda: not told(here, "squeue", "--noheader"), lambda: told(here, "squeue"))
    here.assert_as_alone(alone(LONG))
