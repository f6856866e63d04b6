"""A sweep in processes of this machine, of which one is killed: every run once, the same bits as by one process."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import pytest
from engines import SWEEP, Place, place

pytestmark = pytest.mark.cluster


def test_a_worker_that_is_killed_is_replaced(tmp_path: Path, alone: Place) -> None:
    here = place(tmp_path / "work")
    driver = here.start(sys.executable, "-m", "pipeline", "-m", "launcher=joblib", "hydra.launcher.n_jobs=2", *SWEEP)
    os.kill(next(here.workers(driver)), signal.SIGKILL)
    here.wait(driver)
    here.assert_as_alone(alone)
