"""Sweeps on a real Ray of this machine: every run once, none lost, the same bits as by one process."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from engines import ENGINES, SWEEP, Place, free_ports, place, small_disk, until

pytestmark = pytest.mark.cluster
PYTHON = str(ENGINES / "python")
ATTEMPTS = 4  # Ray ends where its agents take more than 15 s to start, as on a busy machine


@pytest.fixture(scope="module")
def ray(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a Ray of one node with three cores, started in another folder than the sweeps."""
    if not (ENGINES / "ray").exists():
        pytest.skip(f"{ENGINES / 'ray'} not found: make cluster-test installs it")
    elsewhere = place(tmp_path_factory.mktemp("ray"))
    for _ in range(ATTEMPTS):
        (port,) = free_ports(1)
        node = elsewhere.start(
            str(ENGINES / "ray"),
            "start",
            "--head",
            "--block",
            "--num-cpus=3",
            f"--port={port}",
            "--include-dashboard=false",
        )
        until(lambda process=node: process.poll() is not None or "Ray runtime started" in elsewhere.said())
        if node.poll() is None:
            break
    assert node.poll() is None, elsewhere.said()
    yield f"127.0.0.1:{port}"
    node.terminate()
    node.wait()


def launched(address: str) -> list[str]:
    return [PYTHON, "-m", "pipeline", "-m", "launcher=ray", f"+hydra.launcher.ray.init.address='{address}'",
            *SWEEP]  # fmt: skip


def test_workers_that_end_are_replaced(ray: str, tmp_path: Path, alone: Place) -> None:
    here = place(tmp_path / "work")
    driver = here.start(*launched(ray))
    for worker, signum in zip(here.workers(driver), (signal.SIGKILL, signal.SIGTERM, signal.SIGUSR2)):
        os.kill(worker, signum)
    here.wait(driver)
    here.assert_as_alone(alone)


def test_a_full_disk(ray: str, tmp_path: Path, alone: Place) -> None:
    here = place(tmp_path / "work")
    with small_disk(here.folder / "results", megabytes=100):
        (ballast := here.folder / "results/ballast").write_bytes(bytes(99 * 2**20))
        said = here(*launched(ray), status=1)
        assert "found no space left" in said and "Traceback" not in said
        ballast.unlink()
        here(*launched(ray))
        here.assert_as_alone(alone)


def test_a_ray_of_this_sweep_alone(ray: str, tmp_path: Path, alone: Place) -> None:
    work = place(tmp_path / "work")
    work(PYTHON, "-m", "pipeline", "-m", "launcher=ray", *SWEEP)
    work.assert_as_alone(alone)
