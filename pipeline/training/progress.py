"""Progress output of training: a progress bar on a terminal, a line every 5 % elsewhere; in a sweep, the sweep's."""

from __future__ import annotations

import math
import time
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from pipeline.terminal import sweep_progress

SMOOTHING = 0.95  # of the displayed loss and PSNR; log.jsonl has the unsmoothed values
LINES = 20  # of a whole run without a terminal


class TrainingProgress:
    """A context manager; call `update` every few iterations."""

    def __init__(
        self, first: int, iterations: int, time_budget_s: float | None, console: Console | None = None
    ) -> None:
        self._console = console or Console()
        self._first, self._iterations, self._budget = first, iterations, time_budget_s
        self._line_every = max(1, iterations // LINES)
        self._next_line = first + self._line_every
        self._smooth: dict[str, float] = {}
        self._started = time.perf_counter()
        self._bar = Progress(
            TextColumn("{task.completed:.0f}/{task.total:.0f}"),
            BarColumn(),
            TextColumn("{task.fields[text]}"),
            console=self._console,
            disable=not self._console.is_terminal or sweep_progress.current is not None,
            transient=True,
        )
        self._task = self._bar.add_task("train", total=iterations, completed=first, text="")

    def __enter__(self) -> TrainingProgress:
        self._bar.__enter__()
        return self

    def __exit__(self, *exception: Any) -> None:
        self._bar.__exit__(*exception)

    def update(
        self, iteration: int, loss: float, psnr: float, n_gaussians: int, n_alive: float, train_seconds: float
    ) -> None:
        """loss, psnr: of the last batch. n_alive: Gaussians with temporal marginal p(t) >= 0.05, mean over its views.
        train_seconds: since the start."""
        if sweep_progress.current is not None:
            sweep_progress.current.update(iteration, self._iterations, self._first)
            return
        for name, value in (("loss", loss), ("psnr", psnr)):
            if math.isfinite(value):
                self._smooth[name] = SMOOTHING * self._smooth.get(name, value) + (1 - SMOOTHING) * value
        pace = (iteration - self._first) / max(time.perf_counter() - self._started, 1e-9)
        left = (self._iterations - iteration) / max(pace, 1e-9)
        if self._budget is not None:
            left = min(left, max(0.0, self._budget - train_seconds))
        minutes, seconds = divmod(round(left), 60)
        text = (
            f"loss {self._smooth.get('loss', math.nan):.4f}  psnr {self._smooth.get('psnr', math.nan):.2f}  "
            f"N {n_gaussians}  alive {n_alive:.0f}  {pace:.1f} it/s  {minutes}:{seconds:02d} left"
        )
        self._bar.update(self._task, completed=iteration, text=text)
        if not self._console.is_terminal and iteration >= self._next_line:
            self._next_line += self._line_every
            print(f"{iteration}/{self._iterations}  {text}", file=self._console.file, flush=True)

    def line(self, text: str) -> None:
        """Print one line above the bar."""
        if sweep_progress.current is not None:
            return
        self._bar.console.print(text, highlight=False, soft_wrap=True)
