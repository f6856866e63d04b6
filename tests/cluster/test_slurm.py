"""Sweeps on a real Slurm of this machine: every run once, none lost, the same bits as by one process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from engines import ALL_BUT_SEED, SEEDS, SWEEP, Place, place, recipe, small_disk, until

pytestmark = pytest.mark.cluster
RESOURCES = ("hydra.launcher.cpus_per_task=1", "hydra.launcher.mem_gb=1")


@pytest.fixture()
def here(slurm: Path, tmp_path: Path) -> Place:
    return place(tmp_path / "work", SLURM_CONF=str(slurm))


def launched(*more: str) -> list[str]:
    return [sys.executable, "-m", "pipeline", "-m", "launcher=slurm", *RESOURCES, *(more or SWEEP)]


def job_of(worker: int) -> str:
    """The job, or the task of an array, that a process belongs to. SLURM_JOB_ID of one task is that of the array."""
    words = Path(f"/proc/{worker}/environ").read_text().split("\0")
    known = dict(word.split("=", 1) for word in words if word.startswith("SLURM_"))
    if "SLURM_ARRAY_JOB_ID" in known:
        return f"{known['SLURM_ARRAY_JOB_ID']}_{known['SLURM_ARRAY_TASK_ID']}"
    return known["SLURM_JOB_ID"]


def told(here: Place, *command: str) -> str:
    return subprocess.run(
        command, cwd=here.folder, env=here.environment, capture_output=True, text=True, check=True
    ).stdout


def restarts(here: Place, job: str) -> int:
    words = told(here, "scontrol", "show", "job", "--oneliner", job).split()
    return int(next(word for word in words if word.startswith("Restarts=")).split("=")[1])


def stands_still(worker: int) -> bool:
    """False from when it is told that its time is over."""
    try:
        lines = Path(f"/proc/{worker}/status").read_text().splitlines()
    except FileNotFoundError:
        return False
    status = dict(line.split(":\t", 1) for line in lines if ":\t" in line)
    return status["State"].startswith("T") and not int(status["ShdPnd"], 16) >> (signal.SIGUSR2 - 1) & 1


def test_jobs_that_are_stopped_go_on(here: Place, alone: Place) -> None:
    """By signals, by the administrator, and by the kernel, which kills what takes too much memory."""
    driver, jobs = here.start(*launched()), []
    for worker, by in zip(here.workers(driver), ("--signal=TERM", "--signal=USR2", "requeue", "SIGKILL")):
        jobs.append(job_of(worker))
        if by == "SIGKILL":
            os.kill(worker, signal.SIGKILL)
        else:
            told(here, *(["scontrol", by] if by == "requeue" else ["scancel", by]), jobs[-1])
    here.wait(driver)
    assert [restarts(here, job) for job in jobs] == [1, 1, 1, 1]
    here.assert_as_alone(alone)


def test_a_run_that_needs_longer_than_a_job_may(here: Place, alone: Place) -> None:
    """On any machine: it stands still until Slurm says that its time, a minute, is nearly over."""
    limits = ["hydra.launcher.timeout_min=1", "hydra.launcher.signal_delay_s=5"]
    driver = here.start(*launched(*limits, *ALL_BUT_SEED, "seed=0"))
    worker = next(here.workers(driver))
    job = job_of(worker)
    os.kill(worker, signal.SIGSTOP)
    until(lambda: stands_still(worker), here.said, driver)
    until(lambda: not stands_still(worker), here.said, driver)
    with suppress(ProcessLookupError):  # Slurm lets it go on, too
        os.kill(worker, signal.SIGCONT)
    here.wait(driver)
    assert restarts(here, job) == 1
    here.assert_as_alone(alone, seeds=[0])


def test_a_full_disk(here: Place, alone: Place) -> None:
    command = launched("hydra.launcher.submitit_folder=jobs", *SWEEP)
    with small_disk(here.folder / "results", megabytes=100):
        (ballast := here.folder / "results/ballast").write_bytes(bytes(99 * 2**20))
        said = here(*command, status=1)
        logs = "".join(path.read_text() for path in (here.folder / "jobs").glob("*.err"))
        assert "found no space left" in logs + said and "Traceback" not in logs + said
        ballast.unlink()
        here(*command)
        here.assert_as_alone(alone)


def test_an_array_of_listed_commands(here: Place, alone: Place) -> None:
    """The recipe of docs/machines.md; one job is told that its time is over, another one's worker is killed."""
    (here.folder / "runs.txt").write_text(told(here, sys.executable, "-m", "pipeline", "--list", *SWEEP))
    (here.folder / "array.sh").write_text(recipe("array.sh"))
    told(here, "sbatch", f"--array=1-{len(SEEDS)}", "--mem=1G", "array.sh")
    workers = here.workers()
    told(here, "scancel", "--signal=USR2", job_of(next(workers)))
    os.kill(next(workers), signal.SIGKILL)
    until(lambda: not told(here, "squeue", "--noheader"), lambda: told(here, "squeue"))
    here.assert_as_alone(alone)
