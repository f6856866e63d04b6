"""The newest model and numbers of a run, between the thread that trains and those that serve pages.

Packing models takes at most LARGEST_SHARE of the time of training.
"""

from __future__ import annotations

import json
import struct
import threading
import time
from collections.abc import Callable

from datasets.scene import Scene
from pipeline.model.model import Model
from pipeline.model.transformed import in_rotations
from pipeline.training.reporting import Progress, StepReport
from pipeline.view.pack import Packed, pack

SECONDS = 3.0  # between models, at least
LARGEST_SHARE = 0.02  # of the time, spent on packing models
COMPRESSION = 1  # of zlib: the model goes no further than this machine


class Feed:
    """Safe to use from several threads."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._progress: dict | None = None
        self._model: tuple[int, bytes] | None = None
        self.wanted = False  # whether a page waits for a newer model than there is
        self.ended = False  # whether nothing newer will come

    # What training does.

    def report(self, progress: dict) -> None:
        """The numbers of an iteration; pages get the newest ones."""
        with self._changed:
            self._progress = progress
            self._changed.notify_all()

    def offer(self, iteration: int, packed: Packed) -> None:
        header = json.dumps({**packed.header, "iteration": iteration}).encode()
        message = struct.pack("<I", len(header)) + header + packed.data
        with self._changed:
            self._model, self.wanted = (iteration, message), False
            self._changed.notify_all()

    def end(self) -> None:
        with self._changed:
            self.ended = True
            self._changed.notify_all()

    # What a page's request does.

    def model_after(self, iteration: int, seconds: float) -> bytes | None:
        """The newest model if it is of another iteration, an earlier one after a new start: `<u4` length of its header,
        header, data.

        Waits for one up to `seconds`; None where none came.
        """
        with self._changed:
            self.wanted = self.wanted or not self._is_after(iteration)
            self._wait(lambda: self._is_after(iteration), seconds)
            return self._model[1] if self._model and self._is_after(iteration) else None

    def progress_after(self, iteration: int, seconds: float) -> dict | None:
        """Likewise the newest numbers."""

        def newer() -> bool:
            return self._progress is not None and self._progress["iteration"] != iteration

        with self._changed:
            self._wait(newer, seconds)
            return self._progress if newer() else None

    def _is_after(self, iteration: int) -> bool:
        return self._model is not None and self._model[0] != iteration

    def _wait(self, condition: Callable[[], bool], seconds: float) -> None:
        self._changed.wait_for(lambda: condition() or self.ended, seconds)


class TrainingView:
    def __init__(self, feed: Feed, scene: Scene, iterations: int) -> None:
        self._feed, self._scene, self._iterations = feed, scene, iterations
        self._held_out: float | None = None  # PSNR of the last evaluation
        self._next = 0.0  # time.perf_counter() before which no model is packed

    def start(self, iteration: int) -> None: ...

    def step(self, model: Model, report: StepReport) -> None:
        """The model is packed only while a page waits for one."""
        self._feed.report({
            "iteration": report.iteration, "iterations": self._iterations, "loss": report.loss, "psnr": report.psnr,
            "held_out": self._held_out, "n_gaussians": report.n_gaussians,
        })  # fmt: skip
        if self._feed.wanted and time.perf_counter() >= self._next:
            self._pack(model, report.iteration)

    def evaluated(self, model: Model, progress: Progress, metrics: dict) -> None:
        self._held_out = metrics["psnr"]

    def see_last(self, model: Model, iteration: int) -> None:
        """The model that training ended with."""
        self._pack(model, iteration)

    def _pack(self, model: Model, iteration: int) -> None:
        begun = time.perf_counter()
        self._feed.offer(iteration, pack(in_rotations(model), self._scene, COMPRESSION))
        now = time.perf_counter()
        self._next = now + max(SECONDS, (now - begun) / LARGEST_SHARE)
