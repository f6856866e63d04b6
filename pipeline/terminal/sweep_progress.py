"""One line of progress for a whole sweep, whichever processes its runs are in: `17/42 runs, 4 min left`.

The processes share a folder: plan.json has the work of each run and when the sweep began, and a file a run how far it
is. On a terminal the line stays below the lines of finished runs; elsewhere each of these begins with it.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

FOLDER_VARIABLE = "PIPELINE_SWEEP"
UPDATE_EVERY_S = 1.0
TRAINING_SHARE = 0.95  # of the time of a run of train=short; the rest is evaluation
CLEAR_LINE = "\r\x1b[K"


@contextmanager
def sweep(work: dict[str, float]) -> Iterator[None]:
    """work: of each run, by its folder, in any unit."""
    folder = Path(tempfile.mkdtemp(prefix="sweep-"))
    (folder / "plan.json").write_text(json.dumps({"began": time.time(), "work": work}))
    os.environ[FOLDER_VARIABLE] = str(folder)  # for the processes of the sweep
    try:
        yield
    finally:
        del os.environ[FOLDER_VARIABLE]
        shutil.rmtree(folder, ignore_errors=True)
        if sys.stdout.isatty():
            print(flush=True)


def plan_file() -> Path | None:
    """Of the sweep that this process is part of. None without one, and on another machine, which does not see it."""
    file = Path(os.environ.get(FOLDER_VARIABLE, "no sweep")) / "plan.json"
    return file if FOLDER_VARIABLE in os.environ and file.is_file() else None


class SweepRun:
    def __init__(self, folder: Path, began: float, work: dict[str, float], out: str) -> None:
        self._began, self._work = began, list(work.values())
        self._files = [folder / f"run{index}" for index in range(len(work))]
        self._file = self._files[list(work).index(out)]
        self._updated = 0.0

    @classmethod
    def joined(cls, out: str) -> SweepRun | None:
        """The run of this folder; None where no sweep has it."""
        if not (plan := plan_file()):
            return None
        found = json.loads(plan.read_text())
        return cls(plan.parent, found["began"], found["work"], out) if out in found["work"] else None

    def update(self, iteration: int, iterations: int, first: int = 0) -> None:
        """iterations: of all. first: done before the sweep."""
        if time.monotonic() - self._updated < UPDATE_EVERY_S:
            return
        self._updated = time.monotonic()
        self._write(TRAINING_SHARE * iteration / iterations, TRAINING_SHARE * first / iterations)
        if sys.stdout.isatty():
            _print(CLEAR_LINE + self.text())

    def finished(self, line: str) -> None:
        """line: of its result. A run that did not train was finished before the sweep."""
        self._write(1.0, _read(self._file)[1] if self._file.exists() else 1.0)
        _print(f"{CLEAR_LINE}{line}\n{self.text()}" if sys.stdout.isatty() else f"{self.text()}  {line}\n")

    def failed(self) -> None:
        """It is not to do any more. Its error is printed next."""
        self._write(1.0, 1.0)
        if sys.stdout.isatty():
            _print(CLEAR_LINE)

    def text(self) -> str:
        """How many runs have ended, and minutes left from the work that the sweep has done so far."""
        shares = [_read(file) for file in self._files]
        count = f"{sum(share == 1 for share, _ in shares)}/{len(shares)} runs"
        done = sum(work * (share - before) for work, (share, before) in zip(self._work, shares))
        to_do = sum(work * (1 - share) for work, (share, _) in zip(self._work, shares))
        seconds = time.time() - self._began
        if to_do == 0:
            return f"{count} in {_minutes(seconds)}"
        return f"{count}, {_minutes(seconds * to_do / done)} left" if done > 0 else count

    def _write(self, share: float, before: float) -> None:
        """share: of the run's work that is done. before: that was done before the sweep."""
        self._file.write_text(json.dumps([share, before]))


def _read(file: Path) -> tuple[float, float]:
    """What `_write` wrote; 0 where the run has not begun, or its file is being written."""
    try:
        share, before = json.loads(file.read_text())
    except (OSError, ValueError):
        return 0.0, 0.0
    return share, before


def _minutes(seconds: float) -> str:
    return f"{max(1, round(seconds / 60))} min"


def _print(text: str) -> None:
    sys.stdout.write(text)
    sys.stdout.flush()
