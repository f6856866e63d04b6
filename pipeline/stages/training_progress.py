"""Progress output of training: a progress bar on a terminal, a line every 5 % elsewhere; in a sweep, the sweep's."""

from __future__ import annotations

import math
import time
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from pipeline.model.model import Model
from pipeline.terminal import interruption
from pipeline.terminal.sweep_progress import SweepRun, plan_file
from pipeline.training import reporting

SMOOTHING = 0.95  # of the displayed loss and PSNR; log.jsonl has the unsmoothed values
LINES = 20  # of a whole run without a terminal


class TrainingProgress:
    """A context manager that observes a training."""

    def __init__(
        self, iterations: int, time_budget_s: float | None, out: str | None = None, console: Console | None = None
    ) -> None:
        """Of `iterations`, or fewer in `time_budget_s`. out: the run's folder; None: a training within a run."""
        self._console = console or Console()
        self._iterations, self._budget = iterations, time_budget_s
        self._line_every = max(1, iterations // LINES)
        self._quiet = plan_file() is not None
        self._sweep = SweepRun.joined(out) if out else None
        self._smooth: dict[str, float] = {}
        self._bar = Progress(
            TextColumn("{task.completed:.0f}/{task.total:.0f}"),
            BarColumn(),
            TextColumn("{task.fields[text]}"),
            console=self._console,
            disable=not self._console.is_terminal or self._quiet,
            transient=True,
        )
        self._task = self._bar.add_task("train", total=iterations, text="")

    def __enter__(self) -> TrainingProgress:
        self._bar.__enter__()
        return self

    def __exit__(self, *exception: Any) -> None:
        self._bar.__exit__(*exception)

    def start(self, iteration: int) -> None:
        self._first, self._next_line = iteration, iteration + self._line_every
        self._started = time.perf_counter()
        self._bar.update(self._task, completed=iteration)

    def step(self, model: Model, report: reporting.StepReport) -> None:
        interruption.raise_if_lost()
        iteration = report.iteration
        if self._sweep is not None:
            self._sweep.update(iteration, self._iterations, self._first)
        if self._quiet:
            return
        for name, value in (("loss", report.loss), ("psnr", report.psnr)):
            if math.isfinite(value):
                self._smooth[name] = SMOOTHING * self._smooth.get(name, value) + (1 - SMOOTHING) * value
        pace = (iteration - self._first) / max(time.perf_counter() - self._started, 1e-9)
        left = (self._iterations - iteration) / max(pace, 1e-9)
        if self._budget is not None:
            left = min(left, max(0.0, self._budget - report.train_seconds))
        minutes, seconds = divmod(round(left), 60)
        text = (
            f"loss {self._smooth.get('loss', math.nan):.4f}  psnr {self._smooth.get('psnr', math.nan):.2f}  "
            f"N {report.n_gaussians}  alive {report.n_alive:.0f}  {pace:.1f} it/s  {minutes}:{seconds:02d} left"
        )
        self._bar.update(self._task, completed=iteration, text=text)
        if not self._console.is_terminal and iteration >= self._next_line:
            self._next_line += self._line_every
            print(f"{iteration}/{self._iterations}  {text}", file=self._console.file, flush=True)

    def evaluated(self, model: Model, progress: reporting.Progress, metrics: dict) -> None:
        """One line above the bar."""
        self.say(
            f"iteration {progress.iteration}: held-out psnr {metrics['psnr']:.2f} after "
            f"{progress.train_seconds:.0f} s of training, {len(model)} Gaussians"
        )

    def say(self, text: str) -> None:
        """A line above the bar."""
        interruption.raise_if_lost()
        if not self._quiet:
            self._bar.console.print(text, highlight=False, soft_wrap=True)
