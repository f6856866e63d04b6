"""A run folder for a training whose model alone is wanted."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory


@dataclass(frozen=True)
class NoRecord:
    """What train.RunFolder asks for; keeps nothing but the checkpoint, and that while `no_record` lasts."""

    path: Path

    def log(self, row: dict) -> None: ...

    def append_error_vs_time(self, row: dict) -> None: ...

    def truncate_after(self, iteration: int) -> None: ...


@contextmanager
def no_record() -> Iterator[NoRecord]:
    with TemporaryDirectory() as folder:
        yield NoRecord(Path(folder))
