"""Hands a run's numbers and models to the live view while it is trained, in at most LARGEST_SHARE of its time."""

from __future__ import annotations

import time

from datasets.scene import Scene
from pipeline.model.model import Model
from pipeline.model.velocities import in_rotations
from pipeline.view.live.feed import Feed
from pipeline.view.pack import pack

SECONDS = 3.0  # between models, at least
LARGEST_SHARE = 0.02  # of the time, spent on packing models
COMPRESSION = 1  # of zlib: the model goes no further than this machine


class TrainingView:
    """What training.loop calls while it trains."""

    def __init__(self, feed: Feed, scene: Scene, iterations: int) -> None:
        self._feed, self._scene, self._iterations = feed, scene, iterations
        self.held_out: float | None = None  # PSNR of the last evaluation
        self._next = 0.0  # time.perf_counter() before which no model is packed

    def see(self, model: Model, iteration: int, loss: float, psnr: float) -> None:
        """Called every few iterations. The model is packed only while a page waits for one."""
        self._feed.report({
            "iteration": iteration, "iterations": self._iterations, "loss": loss, "psnr": psnr,
            "held_out": self.held_out, "n_gaussians": len(model),
        })  # fmt: skip
        if self._feed.wanted and time.perf_counter() >= self._next:
            self._pack(model, iteration)

    def see_last(self, model: Model, iteration: int) -> None:
        """The model that training ended with."""
        self._pack(model, iteration)

    def _pack(self, model: Model, iteration: int) -> None:
        begun = time.perf_counter()
        self._feed.offer(iteration, pack(in_rotations(model), self._scene, COMPRESSION))
        now = time.perf_counter()
        self._next = now + max(SECONDS, (now - begun) / LARGEST_SHARE)
