"""The log that training writes to besides its checkpoint: the interface of a run folder, and one without output."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Protocol


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
