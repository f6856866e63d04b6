"""A sweep in processes of this machine, of which one is killed: every run once, the same bits as by one process."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from engines import Place, place, sweep

pytestmark = pytest.mark.cluster
LONG = 400


def test_a_worker_that_is_killed_is_replaced(tmp_path: Path, alone: Callable[[int], Place]) -> None:
    here = place(tmp_path / "work")
    driver = here.start(
        sys.executable, "-m", "pipeline", "-m", "launcher=joblib", "hydra.launcher.n_jobs=2", *sweep(LONG)
    )
    os.kill(here.worker(1, driver), signal.SIGKILL)
    here.wait(driver)
    here.assert_as_alone(alone(LONG))
