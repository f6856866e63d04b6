"""How the tests run: side by side without getting in each other's way, and a test of real data only on request.

`make test` spreads the files over processes (pytest-xdist, `--dist loadscope`: a file's tests stay in one process, so
that its fixtures are made once). A test that needs a real data set is marked `data`; pyproject.toml deselects it
(`-m "not data"`, so it is not counted as skipped), `make test-data DATA_DIR=…` selects it (`-m data`).
"""

from __future__ import annotations

import os

# Set before anything loads OpenMP, and handed down to the processes that tests start. One thread where a test does not
# ask for more: processes already fill the cores. Threads that wait sleep, as others want the core they would spin on.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import pytest  # noqa: E402

MOST_PROCESSES = 8  # more would wait for the longest file
# The longest files, longest first: one that began last would leave the other processes idle.
LONGEST = (
    "test_pipeline", "test_kernel_precision", "test_sfm", "test_clip_set", "test_sweeper", "test_kernel_stability",
    "test_sfm_clip", "test_filmed", "test_first_contact", "test_config", "test_atomic_write", "test_settle",
)  # fmt: skip


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """For `-n auto`: the cores this process may run on. rasterizer.cores would import torch here, for nothing."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(cores, MOST_PROCESSES)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest files first, all others in their order."""
    rank = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: rank.get(item.path.stem, len(rank)))
