"""How many processors this process may use: the one place that says so."""

from __future__ import annotations

import os


def usable_cores() -> int:
    """Cores this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def thread_count(threads: int) -> int:
    """threads: 0 for as many as this process may use."""
    return threads or usable_cores()
