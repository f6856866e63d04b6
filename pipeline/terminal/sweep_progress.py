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
SKIPPED, FAILED = "skipped", "failed"  # what the file of a run has that was finished before, or failed
CLEAR_LINE = "\r\x1b[K"


@contextmanager
def sweep(work: dict[str, float]) -> Iterator[None]:
    """work: of each run, by its folder, in any unit. Without runs, nothing."""
    if not work:
        yield
        return
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


class SweepRun:
    """A run's part in it."""

    def __init__(self, folder: Path, out: str, iterations: int) -> None:
        self._folder = folder
        plan = json.loads((folder / "plan.json").read_text())
        self._began, self._work = plan["began"], plan["work"]
        self._work.setdefault(out, 1.0)
        self._file = folder / f"run{list(self._work).index(out)}"
        self._iterations = iterations
        self._trained, self._updated = False, 0.0
        self._resumed = 0.0  # share of its work that was done before the sweep

    @classmethod
    def joined(cls, out: str, iterations: int) -> SweepRun | None:
        """None where no sweep is announced: a job on another machine does not see its folder."""
        folder = os.environ.get(FOLDER_VARIABLE)
        return cls(Path(folder), out, iterations) if folder and (Path(folder) / "plan.json").is_file() else None

    def update(self, iteration: int, iterations: int, first: int = 0) -> None:
        """iterations: of all; a training within the run that has fewer is no progress. first: done before the sweep."""
        if iterations != self._iterations or time.monotonic() - self._updated < UPDATE_EVERY_S:
            return
        self._trained, self._updated = True, time.monotonic()
        self._resumed = TRAINING_SHARE * first / iterations
        self._file.write_text(f"{TRAINING_SHARE * iteration / iterations} {self._resumed}")
        if sys.stdout.isatty():
            self._write(CLEAR_LINE + self.text())

    def finished(self, line: str) -> None:
        """line: of its result. Printed once, also if two sweeps have the run."""
        if not _is_finished(_read(self._file)):
            self._file.write_text(f"1 {self._resumed}" if self._trained else SKIPPED)
            self._write(f"{CLEAR_LINE}{line}\n{self.text()}" if sys.stdout.isatty() else f"{self.text()}  {line}\n")

    def failed(self) -> None:
        """Its error is printed next."""
        self._file.write_text(FAILED)
        if sys.stdout.isatty():
            self._write(CLEAR_LINE)

    def text(self) -> str:
        """How many runs are done, and minutes left from the work that the sweep has done so far."""
        states = [_read(self._folder / f"run{index}") for index in range(len(self._work))]
        ended = sum(_is_finished(state) or state == FAILED for state in states)
        count = f"{ended}/{len(states)} runs"
        shares = [(work, *state) for work, state in zip(self._work.values(), states) if not isinstance(state, str)]
        done = sum(work * (share - resumed) for work, share, resumed in shares)
        to_do = sum(work * (1 - share) for work, share, _ in shares)
        seconds = time.time() - self._began
        if to_do == 0:
            return f"{count} in {_minutes(seconds)}"
        return f"{count}, {_minutes(seconds * to_do / done)} left" if done > 0 else count

    def _write(self, text: str) -> None:
        sys.stdout.write(text)
        sys.stdout.flush()


def _read(file: Path) -> tuple[float, float] | str:
    """(share of the run's work that is done, share that was done before the sweep), or why it has none."""
    try:
        text = file.read_text()
    except OSError:
        return 0.0, 0.0
    try:
        share, resumed = map(float, text.split())
    except ValueError:
        return text or (0.0, 0.0)  # empty: it is being written
    return share, resumed


def _is_finished(state: tuple[float, float] | str) -> bool:
    return state == SKIPPED or state[0] == 1.0


def _minutes(seconds: float) -> str:
    return f"{max(1, round(seconds / 60))} min"


current: SweepRun | None = None  # of this process
