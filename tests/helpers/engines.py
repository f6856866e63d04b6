"""A folder where a sweep is run by another program, and what must have come of it."""

from __future__ import annotations

import hashlib
import json
import os
import re
import secrets
import socket
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from safetensors import safe_open
from shell import TINY

ROOT = Path(__file__).resolve().parents[2]
ENGINES = ROOT / "build" / "cluster" / "bin"  # of `make cluster-test`: Ray and HyperQueue
RAY = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32),
       "RAY_raylet_start_wait_time_s": "120"}  # fmt: skip
LONGEST_S = 600  # of a sweep, on a machine that is busy with other things
SEEDS = range(4)
# Runs of some seconds, in which something can happen.
ALL_BUT_SEED = (*TINY, "train.iterations=400", "train.checkpoint_every=50")
SWEEP = (*ALL_BUT_SEED, f"seed={','.join(map(str, SEEDS))}")
STAGES = ["prepare", "settle", "init", "train", "evaluate", "page"]


@dataclass(frozen=True)
class Place:
    """A folder where a sweep is run."""

    folder: Path
    environment: dict[str, str]

    def start(self, *command: str) -> subprocess.Popen:
        """Standard output and error go to the file `said`."""
        with open(self.folder / "said", "ab") as said:
            return subprocess.Popen(
                command, cwd=self.folder, env=self.environment, stdout=said, stderr=subprocess.STDOUT
            )

    def __call__(self, *command: str, status: int = 0) -> str:
        process = self.start(*command)
        self.wait(process, status)
        return self.said()

    def wait(self, process: subprocess.Popen, status: int = 0) -> None:
        try:
            found = process.wait(LONGEST_S)
        finally:
            process.kill()
        assert found == status, self.said()

    def said(self) -> str:
        return (self.folder / "said").read_text()

    def run(self, seed: int) -> Path:
        return self.folder / f"results/runs/synthetic/wheel/full/smoke/seed{seed}"

    def workers(self, driver: subprocess.Popen | None = None) -> Iterator[int]:
        """The processes that train the runs, each when it has saved a checkpoint. driver: that must not end before."""
        waiting = list(SEEDS)
        while waiting:
            until(lambda seeds=tuple(waiting): any(map(self._has_checkpoint, seeds)), self.said, driver)
            seed = next(filter(self._has_checkpoint, waiting))
            waiting.remove(seed)
            (claim,) = self.run(seed).glob(".claim-*")
            yield int(re.search(r"process (\d+)", claim.read_text())[1])

    def _has_checkpoint(self, seed: int) -> bool:
        return (self.run(seed) / "checkpoint.safetensors").exists()

    def assert_as_alone(self, alone: Place, seeds: Iterable[int] = SEEDS) -> None:
        """Every run is there, each stage of it was finished once, and it has the same bits as by one process."""
        for seed in seeds:
            rows = map(json.loads, (self.run(seed) / "log.jsonl").read_text().splitlines())
            finished = [row["event"].split()[1] for row in rows if row.get("event", "").startswith("finished ")]
            assert finished == STAGES, f"seed {seed}"
            assert bits(self.run(seed)) == bits(alone.run(seed)), f"seed {seed}"


def bits(run: Path) -> str:
    """Of the trained model and all that the rest of a training would depend on, but not the seconds it took."""
    digest = hashlib.sha256()
    with safe_open(run / "checkpoint.safetensors", "numpy") as file:
        for name in sorted(file.keys()):
            digest.update(name.encode() + file.get_tensor(name).tobytes())
    for image in sorted((run / "renders").glob("*.png")):
        digest.update(image.name.encode() + image.read_bytes())
    return digest.hexdigest()


def until(
    happened: Callable[[], object], said: Callable[[], str] = str, process: subprocess.Popen | None = None
) -> None:
    """Waits. said: what is shown where it does not happen; process: that must not end before."""
    began = time.monotonic()
    while not happened():
        assert time.monotonic() - began < LONGEST_S and (process is None or process.poll() is None), said()
        time.sleep(0.05)


def place(folder: Path, **environment: str) -> Place:
    folder.mkdir(parents=True, exist_ok=True)
    return Place(folder, {**os.environ, "PYTHONPATH": str(ROOT), **RAY, **environment})


@contextmanager
def small_disk(folder: Path, megabytes: int) -> Iterator[None]:
    """A disk of its own at `folder`."""
    folder.mkdir(parents=True)
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={megabytes}m", "tmpfs", folder], capture_output=True, text=True
    )
    if mounted.returncode:
        pytest.skip(f"a small disk cannot be mounted here: {mounted.stderr.strip()}")
    try:
        yield
    finally:
        subprocess.run(["umount", "--lazy", folder], check=True)


def free_ports(count: int) -> list[int]:
    sockets = [socket.socket() for _ in range(count)]
    for one in sockets:
        one.bind(("127.0.0.1", 0))
    ports = [one.getsockname()[1] for one in sockets]
    for one in sockets:
        one.close()
    return ports


def recipe(name: str) -> str:
    """The file of this name in docs/machines.md, whose first comment there is its name."""
    page = (ROOT / "docs" / "machines.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```\w+\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    (block,) = (block for block in blocks if f"# {name}" in block.splitlines())
    return block
