"""Runs a search in a separate process: if it crashes or hangs, its current case is the finding."""

from __future__ import annotations

import faulthandler
import hashlib
import json
import multiprocessing
import os
import resource
import shutil
import tempfile
import traceback
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from fuzz.search import search
from fuzz.target import Changes, Target, load_changes, save_changes

MEMORY = 16 << 30  # bytes of address space; beyond it allocations raise MemoryError
GRACE = 600.0  # further seconds for shrinking
LOG_SHOWN = 30  # lines
MEMORY_DISK = "/dev/shm" if os.path.isdir("/dev/shm") else None  # cases are many small files


@dataclass(frozen=True)
class Report:
    """The result of a search."""

    target: Target
    outcomes: dict[str, int]  # how many cases were valid, refused, …
    error: str | None  # the violation; None: no case violated the rule
    saved: Path | None  # folder of the input

    def lines(self) -> list[str]:
        tally = ", ".join(f"{count} {outcome}" for outcome, count in sorted(self.outcomes.items())) or "not counted"
        if self.error is None:
            return [f"{self.target.name}: {sum(self.outcomes.values())} cases ({tally}), no violation"]
        return [
            f"{self.target.name}: VIOLATION, input saved in {self.saved}",
            *self.error.splitlines(),
            f"replay: python -m fuzz {self.target.name} --replay {self.saved}",
        ]


def fuzz(target: Target, seconds: float, seed: int, keep: Path) -> Report:
    """Searches for `seconds`. keep: the folder for inputs that violate the rule."""
    with tempfile.TemporaryDirectory(prefix="fuzz-", dir=MEMORY_DISK) as temporary:
        folder = Path(temporary)
        process = multiprocessing.get_context("spawn").Process(target=_child, args=(target, seconds, seed, folder))
        process.start()
        process.join(seconds + GRACE)
        if process.is_alive():
            process.kill()
            process.join()
        verdict = folder / "verdict.json"
        if verdict.exists():
            result = json.loads(verdict.read_text())
            outcomes, error = result["outcomes"], result["error"]
        else:
            path = folder / "log.txt"
            log = path.read_text(errors="replace").splitlines() if path.exists() else []
            outcomes = {}
            error = "\n".join(
                [f"the process ended with status {process.exitcode}, at this input or before it", *log[-LOG_SHOWN:]]
            )
        saved = None if error is None else _save(load_changes(folder / "changes"), keep / target.name)
        return Report(target, outcomes, error, saved)


def _save(changes: Changes, folder: Path) -> Path:
    digest = hashlib.blake2b(repr(sorted(changes.items())).encode(), digest_size=5).hexdigest()
    save_changes(folder / digest, changes)
    return folder / digest


def _child(target: Target, seconds: float, seed: int, folder: Path) -> None:
    log = os.open(folder / "log.txt", os.O_WRONLY | os.O_CREAT)
    for stream in (1, 2):  # includes the output of libraries
        os.dup2(log, stream)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    faulthandler.enable()

    def begin(changes: Changes) -> None:
        save_changes(folder / "changes", changes)
        faulthandler.dump_traceback_later(target.limit, exit=True)

    found = search(target, folder / "case", seed, seconds, begin=begin, end=faulthandler.cancel_dump_traceback_later)
    error = None
    if found.finding is not None:
        save_changes(folder / "changes", found.finding.changes)
        found.finding.error.__notes__ = []  # Hypothesis adds the whole input as a note
        error = "".join(traceback.format_exception(found.finding.error))
    result = {"outcomes": Counter(found.outcomes), "error": error}
    (folder / "verdict.tmp").write_text(json.dumps(result))
    shutil.move(folder / "verdict.tmp", folder / "verdict.json")
