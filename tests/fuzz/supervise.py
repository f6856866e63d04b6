"""A search in a process of its own: when that dies or stands still, the case it was at is the finding."""

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
from fuzz.target import Changes, Target, keep_changes, kept_changes

MEMORY = 16 << 30  # bytes of address space: what asks for more gets a MemoryError, not the machine's last page
GRACE = 600.0  # seconds after its time that a search may take to shrink what it found
LOG_SHOWN = 30  # lines
MEMORY_DISK = "/dev/shm" if os.path.isdir("/dev/shm") else None  # a case is many small files


@dataclass(frozen=True)
class Report:
    """What a search came to, told by the process that watched it."""

    target: Target
    outcomes: dict[str, int]  # how many cases were valid, refused, …
    fault: str | None  # what was found; None: every case kept the rule
    kept: Path | None  # the input

    def lines(self) -> list[str]:
        tally = ", ".join(f"{count} {outcome}" for outcome, count in sorted(self.outcomes.items())) or "not counted"
        if self.fault is None:
            return [f"{self.target.name}: {sum(self.outcomes.values())} cases ({tally}), all keep the rule"]
        return [
            f"{self.target.name}: FOUND, input kept in {self.kept}",
            *self.fault.splitlines(),
            f"replay: python -m fuzz {self.target.name} --replay {self.kept}",
        ]


def fuzz(target: Target, seconds: float, seed: int, keep: Path) -> Report:
    """Search for `seconds`. keep: the folder that inputs are kept under."""
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
            told = json.loads(verdict.read_text())
            outcomes, fault = told["outcomes"], told["fault"]
        else:
            path = folder / "log.txt"
            log = path.read_text(errors="replace").splitlines() if path.exists() else []
            outcomes = {}
            fault = "\n".join(
                [f"the process ended with status {process.exitcode}, at this input or before it", *log[-LOG_SHOWN:]]
            )
        kept = None if fault is None else _keep(kept_changes(folder / "changes"), keep / target.name)
        return Report(target, outcomes, fault, kept)


def _keep(changes: Changes, folder: Path) -> Path:
    digest = hashlib.blake2b(repr(sorted(changes.items())).encode(), digest_size=5).hexdigest()
    keep_changes(folder / digest, changes)
    return folder / digest


def _child(target: Target, seconds: float, seed: int, folder: Path) -> None:
    log = os.open(folder / "log.txt", os.O_WRONLY | os.O_CREAT)
    for stream in (1, 2):  # also what libraries print
        os.dup2(log, stream)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    faulthandler.enable()

    def begin(changes: Changes) -> None:
        keep_changes(folder / "changes", changes)
        faulthandler.dump_traceback_later(target.limit, exit=True)

    found = search(target, folder / "case", seed, seconds, begin=begin, end=faulthandler.cancel_dump_traceback_later)
    fault = None
    if found.finding is not None:
        keep_changes(folder / "changes", found.finding.changes)
        found.finding.error.__notes__ = []  # Hypothesis writes the whole input there
        fault = "".join(traceback.format_exception(found.finding.error))
    told = {"outcomes": Counter(found.outcomes), "fault": fault}
    (folder / "verdict.tmp").write_text(json.dumps(told))
    shutil.move(folder / "verdict.tmp", folder / "verdict.json")
