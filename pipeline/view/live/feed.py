"""The newest model and numbers of a run, between the thread that trains and those that serve pages."""

from __future__ import annotations

import json
import struct
import threading
from collections.abc import Callable

from pipeline.view.pack import Packed


class Feed:
    """Safe to use from several threads."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._progress: dict | None = None
        self._model: tuple[int, bytes] | None = None
        self._wanted = False
        self._ended = False

    # What training does.

    @property
    def wanted(self) -> bool:
        """Whether a page waits for a newer model than there is."""
        return self._wanted

    def report(self, progress: dict) -> None:
        """The numbers of an iteration; pages get the newest ones."""
        with self._changed:
            self._progress = progress
            self._changed.notify_all()

    def offer(self, iteration: int, packed: Packed) -> None:
        """A newer model."""
        header = json.dumps({**packed.header, "iteration": iteration}).encode()
        message = struct.pack("<I", len(header)) + header + packed.data
        with self._changed:
            self._model, self._wanted = (iteration, message), False
            self._changed.notify_all()

    def end(self) -> None:
        """Nothing newer will come."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    # What a page's request does.

    @property
    def ended(self) -> bool:
        return self._ended

    def model_after(self, iteration: int, seconds: float) -> bytes | None:
        """The newest model if it is of another iteration, an earlier one after a new start: `<u4` length of its header,
        header, data.

        Waits for one up to `seconds`; None where none came.
        """
        with self._changed:
            self._wanted = self._wanted or not self._is_after(iteration)
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
        self._changed.wait_for(lambda: condition() or self._ended, seconds)
