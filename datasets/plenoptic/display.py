"""Progress display of decoding: a progress bar on a terminal, one line per camera elsewhere."""

from __future__ import annotations

import threading
import time
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from datasets.source import Log


class DecodingDisplay:
    """A context manager; `frame` and `camera` are thread-safe."""

    def __init__(self, cameras: int, frames: int, log: Log, console: Console | None = None) -> None:
        """Numbers of cameras and of frames to decode."""
        self._console = console or Console()
        self._cameras, self._frames, self._log = cameras, frames, log
        self._cameras_done = self._frames_done = 0
        self._lock = threading.Lock()
        self._started = time.perf_counter()
        self._bar = Progress(
            TextColumn("{task.completed:.0f}/{task.total:.0f}"),
            BarColumn(),
            TextColumn("{task.fields[text]}"),
            console=self._console,
            disable=not self._console.is_terminal,
            transient=True,
        )
        self._task = self._bar.add_task("decode", total=self._frames, text="frames decoded")

    def __enter__(self) -> DecodingDisplay:
        self._bar.__enter__()
        return self

    def __exit__(self, *exception: Any) -> None:
        self._bar.__exit__(*exception)

    def frame(self) -> None:
        """Counts one written frame."""
        with self._lock:
            self._frames_done += 1
            self._bar.update(self._task, completed=self._frames_done, text=f"frames decoded  {self._pace()}")

    def camera(self, name: str) -> None:
        """Reports a finished camera."""
        with self._lock:
            self._cameras_done += 1
            line = f"decoded {name}: {self._cameras_done} of {self._cameras} cameras  {self._pace()}"
        if not self._console.is_terminal:
            self._log(line)

    def _pace(self) -> str:
        pace = self._frames_done / max(time.perf_counter() - self._started, 1e-9)
        minutes, seconds = divmod(round((self._frames - self._frames_done) / max(pace, 1e-9)), 60)
        return f"{pace:.0f} frames/s  {minutes}:{seconds:02d} left"
