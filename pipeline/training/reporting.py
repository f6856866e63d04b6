"""What training reports to: the log of a run, and whoever looks on."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Protocol

from pipeline.model.model import Model


@dataclass(frozen=True)
class Spent:
    """Time of training; evaluation excluded."""

    seconds: float = 0.0  # of the clock
    cpu_seconds: float = 0.0  # of all threads of this process

    @classmethod
    def by_now(cls) -> Spent:
        """Since some moment before; only differences have a meaning."""
        return cls(time.perf_counter(), time.process_time())

    def __add__(self, other: Spent) -> Spent:
        return Spent(self.seconds + other.seconds, self.cpu_seconds + other.cpu_seconds)

    def __sub__(self, other: Spent) -> Spent:
        return Spent(self.seconds - other.seconds, self.cpu_seconds - other.cpu_seconds)


NOTHING_SPENT = Spent()


@dataclass(frozen=True)
class Progress:
    iteration: int
    train_seconds: float  # evaluation excluded


@dataclass(frozen=True)
class StepReport(Progress):
    loss: float  # of the iteration's batch
    psnr: float  # dB, of the batch's last view
    n_gaussians: int
    n_alive: float  # Gaussians with temporal marginal p(t) >= 0.05, mean over the batch


class Observer(Protocol):
    """Looks on while a model is trained, such as a progress bar; changes nothing. Its time is not training time."""

    def start(self, iteration: int) -> None:
        """Training begins, or continues, after `iteration`."""

    def step(self, model: Model, report: StepReport) -> None:
        """Called every few iterations."""

    def evaluated(self, model: Model, progress: Progress, metrics: dict) -> None:
        """Called after each evaluation on held-out views."""


class RunLog(Protocol):
    """The part of a run folder that training uses; see pipeline/runs/run_folder.py."""

    @property
    def path(self) -> Path: ...  # folder of the checkpoint

    def log(self, row: dict) -> None: ...  # a line of log.jsonl
    def append_error_vs_time(self, row: dict) -> None: ...
    def truncate_after(self, iteration: int) -> None: ...  # drop rows of later iterations from both


@dataclass(frozen=True)
class NoLog:
    """Discards all rows; the checkpoint goes to a temporary folder."""

    path: Path

    def log(self, row: dict) -> None: ...

    def append_error_vs_time(self, row: dict) -> None: ...

    def truncate_after(self, iteration: int) -> None: ...


@contextmanager
def temporary_run() -> Iterator[NoLog]:
    """A run folder for a training of which only the returned model is used; removed afterwards."""
    with TemporaryDirectory() as folder:
        yield NoLog(Path(folder))
