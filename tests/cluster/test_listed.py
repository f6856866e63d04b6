"""The recipes of docs/machines.md for listed commands: every run once, the same bits as by one process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from engines import ENGINES, SWEEP, Place, place, recipe

pytestmark = pytest.mark.cluster
SERVER = """
import sys
from hyperqueue import LocalCluster
from hyperqueue.cluster import WorkerConfig

with LocalCluster(sys.argv[1], WorkerConfig(cores=3)):
    print("ready", flush=True)
    sys.stdin.read()
"""


@pytest.fixture()
def here(tmp_path: Path) -> Place:
    work = place(tmp_path / "work")
    (work.folder / "again.sh").write_text(recipe("again.sh"))
    listed = [sys.executable, "-m", "pipeline", "--list", *SWEEP]
    (work.folder / "runs.txt").write_bytes(subprocess.check_output(listed, cwd=work.folder, env=work.environment))
    return work


def disturbed(here: Place, *command: str) -> None:
    """While the command runs, one run is killed, and two are asked to stop."""
    driver = here.start(*command)
    for worker, signum in zip(here.workers(driver), (signal.SIGKILL, signal.SIGTERM, signal.SIGUSR2)):
        os.kill(worker, signum)
    here.wait(driver)


def test_xargs(here: Place, alone: Place) -> None:
    disturbed(here, "bash", "-c", "xargs -a runs.txt -P 3 -I{} sh again.sh bash -c {}")
    here.assert_as_alone(alone)


def test_hyperqueue(here: Place, alone: Place) -> None:
    python = str(ENGINES / "python")
    if subprocess.run([python, "-c", "import hyperqueue"], capture_output=True).returncode:
        pytest.skip(f"{python} has no hyperqueue: make cluster-test installs it")
    (here.folder / "submit.py").write_text(recipe("submit.py"))
    server = subprocess.Popen([python, "-c", SERVER, here.folder / "server"], env=here.environment, text=True,
                              stdin=subprocess.PIPE, stdout=subprocess.PIPE)  # fmt: skip
    try:
        assert "ready\n" in server.stdout, "HyperQueue ended"
        disturbed(here, "bash", "-c", f"{python} submit.py server < runs.txt")
    finally:
        server.communicate("")
    here.assert_as_alone(alone)
