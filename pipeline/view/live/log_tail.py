"""The newest numbers in a log.jsonl that grows."""

from __future__ import annotations

import json
from pathlib import Path


class LogTail:
    """Reads only what was added since the last time."""

    def __init__(self, path: Path, iterations: int) -> None:
        self._path, self._iterations = path, iterations
        self._place = 0
        self._held_out: float | None = None

    def newest(self) -> dict | None:
        """The numbers of the newest iteration, as TrainingView.see takes them; None without a newer one."""
        if not self._path.exists():
            return None
        with open(self._path, "rb") as file:
            file.seek(0, 2)
            if file.tell() < self._place:  # the run was started anew
                self._place = 0
            file.seek(self._place)
            text = file.read()
        whole = text[: text.rfind(b"\n") + 1]
        self._place += len(whole)
        found = None
        for line in whole.splitlines():
            try:
                row = json.loads(line)
                if row["event"] == "evaluate":
                    self._held_out = row["psnr"]
                elif row["event"] == "train":
                    found = {name: row[name] for name in ("iteration", "loss", "psnr", "n_gaussians")}
            except (ValueError, KeyError, TypeError):
                continue
        return found and {**found, "iterations": self._iterations, "held_out": self._held_out}
