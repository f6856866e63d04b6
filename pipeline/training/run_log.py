"""What training writes besides its checkpoint: the interface of a run folder, and one that keeps nothing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Protocol


class RunLog(Protocol):
    """What training needs of a run folder; see pipeline/runs/run_folder.py."""

    path: Path  # where the checkpoint goes

    def log(self, row: dict) -> None: ...  # a line of log.jsonl
    def append_error_vs_time(self, row: dict) -> None: ...
    def truncate_after(self, iteration: int) -> None: ...  # drop rows of later iterations from both


@dataclass(frozen=True)
class Unrecorded:
    """Keeps the checkpoint alone, in a folder that `unrecorded` removes."""

    path: Path

    def log(self, row: dict) -> None: ...

    def append_error_vs_time(self, row: dict) -> None: ...

    def truncate_after(self, iteration: int) -> None: ...


@contextmanager
def unrecorded() -> Iterator[Unrecorded]:
    """For a training whose model alone is wanted."""
    with TemporaryDirectory() as folder:
        yield Unrecorded(Path(folder))
