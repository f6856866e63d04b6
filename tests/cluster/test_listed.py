"""The recipes of docs/machines.md for listed commands: every run once, the same bits as by one process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from engines import ENGINES, Place, place, recipe, sweep

pytestmark = pytest.mark.cluster
LONG = 400
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
    listed = [sys.executable, "-m", "pipeline", "--list", *sweep(LONG)]
    (work.folder / "runs.txt").write_bytes(subprocess.check_output(listed, cwd=work.folder, env=work.environment))
    return work


def disturbed(here: Place, *command: str) -> None:
    """While the command runs, one run is killed, and another one asked to stop."""
    driver = here.start(*command)
    os.kill(here.worker(1, driver), signal.SIGKILL)
    os.kill(here.worker(2, driver), signal.SIGTERM)
    here.wait(driver)


def test_xargs(here: Place, alone: Callable[[int], Place]) -> None:
    disturbed(here, "bash", "-c", "xargs -a runs.txt -P 3 -I{} sh again.sh bash -c {}")
    here.assert_as_alone(alone(LONG))


def test_hyperqueue(here: Place, alone: Callable[[int], Place]) -> None:
    python = str(ENGINES / "python")
    if subprocess.run([python, "-c", "import hyperqueue"], capture_output=True).returncode:
        pytest.skip(f"{python} has no hyperqueue: make cluster-test installs it")
    (here.folder / "submit.py").write_text(recipe("submit.py"))
    server = subprocess.Popen([python, "-c", SERVER, here.folder / "server"], env=here.environment, text=True,
                              stdin=subprocess.PIPE, stdout=subprocess.PIPE)  # fmt: skip
    try:
        assert server.stdout.readline() == "ready\n"
        disturbed(here, "bash", "-c", f"{python} submit.py server < runs.txt")
    finally:
        server.communicate("")
    here.assert_as_alone(alone(LONG))
