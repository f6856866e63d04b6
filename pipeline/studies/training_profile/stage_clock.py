"""CPU seconds by stage of a program that knows nothing of it: its functions are replaced by timed ones."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Any
from unittest.mock import patch


class StageClock:
    """Seconds of CPU by stage. Where stages are nested, time counts for the innermost, but for none within a stage
    that is entered whole."""

    def __init__(self, clock: Callable[[], float] = time.process_time) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self._clock = clock
        self._stack: list[str] = []
        self._since = clock()
        self._whole = False

    @contextmanager
    def stage(self, name: str, whole: bool = False) -> Iterator[None]:
        if self._whole:
            yield
            return
        self._pass_time()
        self._stack.append(name)
        self._whole = whole
        try:
            yield
        finally:
            self._pass_time()
            self._whole = False
            self._stack.pop()

    def move(self, source: str, parts: dict[str, float]) -> None:
        """Count seconds of `source` for other stages instead."""
        for name, seconds in parts.items():
            self.seconds[source] -= seconds
            self.seconds[name] += seconds

    @contextmanager
    def timing(self, owner: Any, function: str, name: str, whole: bool = False) -> Iterator[None]:
        """Time what `owner`, a module or a class, calls `function`."""
        original = getattr(owner, function)

        @wraps(original)
        def timed(*args: Any, **kwargs: Any) -> Any:
            with self.stage(name, whole):
                return original(*args, **kwargs)

        with patch.object(owner, function, timed):
            yield

    def _pass_time(self) -> None:
        now = self._clock()
        if self._stack:
            self.seconds[self._stack[-1]] += now - self._since
        self._since = now
