"""How many processor cores this process may use; the default number of threads everywhere."""

from __future__ import annotations

import os

from rasterizer.validation import is_integer_in, short_repr

MAX_THREADS = 1024


def usable_cores() -> int:
    """Cores this process may run on (its CPU affinity)."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def thread_count(threads: int) -> int:
    """`threads`, or all usable cores for 0. ValueError for anything but such an integer."""
    if not is_integer_in(threads, 0, MAX_THREADS):
        raise ValueError(f"threads must be in 0..{MAX_THREADS}, got {short_repr(threads)}")
    return threads or usable_cores()
