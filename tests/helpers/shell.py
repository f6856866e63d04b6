"""Runs the command line in a folder of its own, and reads what a run left."""

from __future__ import annotations

import json
import multiprocessing
import os
import resource
import runpy
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from datasets.files.claim import NAME as CLAIM
from pipeline.config.compose import CONFIG_DIR

# Overrides of a run that takes seconds.
TINY = (
    "scene=synthetic/wheel",
    "train=smoke",
    "scene.size=48",
    "scene.train_views=8",
    "scene.test_views=3",
    "threads=1",
    "evaluate.lpips=false",
)
LONGEST_S = 120  # of a command
# Each command is a process of its own, forked from one that has imported what takes seconds. It has run no parallel
# region, after which a fork hangs.
FORKING = multiprocessing.get_context("forkserver")
FORKING.set_forkserver_preload(
    ["pipeline.cli", "pipeline.stages.run", "pipeline.trained.open_run", "datasets.plenoptic"]
)


class Command:
    """A command at work. Standard output and error go to files, which can be read meanwhile."""

    def __init__(self, folder: Path, module: str, arguments: tuple[str, ...], largest_file: int | None = None) -> None:
        """largest_file: bytes of a file beyond which the disk is full."""
        self._streams = tempfile.TemporaryDirectory(prefix="command-")
        self._out, self._err = (Path(self._streams.name) / name for name in ("out", "err"))
        self._process = FORKING.Process(
            target=_run, args=(folder, module, arguments, self._out, self._err, largest_file)
        )
        self._process.start()

    def said(self) -> str:
        """Standard output so far."""
        return self._out.read_text() if self._out.exists() else ""

    def is_running(self) -> bool:
        return self._process.exitcode is None

    def claims(self, run: Path) -> bool:
        """Whether the run folder is claimed by this process."""
        return any(path.read_text().endswith(f"process {self._process.pid}") for path in run.glob(f"{CLAIM}*"))

    def interrupt(self, by: signal.Signals = signal.SIGINT) -> None:
        """SIGINT is what Ctrl-C sends."""
        os.kill(self._process.pid, by)

    def kill(self) -> None:
        """SIGKILL."""
        self._process.kill()
        self._process.join()

    def wait(self) -> tuple[int, str, str]:
        """(exit status, standard output, standard error)."""
        self._process.join(LONGEST_S)
        if self.is_running():
            self.kill()
        return self._process.exitcode, self.said(), self._err.read_text()


def _run(folder: Path, module: str, arguments: tuple[str, ...], out: Path, err: Path, largest_file: int | None) -> None:
    """`python -m module arguments`, in the forked process."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job, as CI may be, ignores it
    os.chdir(folder)
    for stream, path in ((1, out), (2, err)):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT), stream)
    if largest_file is not None:
        limit_files(largest_file)
    sys.argv = [module, *arguments]
    runpy.run_module(module, run_name="__main__", alter_sys=True)


def limit_files(largest: int) -> None:
    """Writes beyond `largest` bytes of a file fail, as on a full disk."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))


class Shell:
    """Runs `python -m pipeline` in a folder of its own, scenes cached between runs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def start(self, *arguments: str, module: str = "pipeline", largest_file: int | None = None) -> Command:
        return Command(self.folder, module, arguments, largest_file)

    def __call__(
        self, *arguments: str, status: int = 0, module: str = "pipeline", largest_file: int | None = None
    ) -> tuple[str, str]:
        found, out, err = self.start(*arguments, module=module, largest_file=largest_file).wait()
        assert found == status, err
        return out, err

    def fresh(self, *arguments: str, status: int = 0) -> tuple[str, str]:
        """In a Python that has imported nothing, as from a terminal: seconds more."""
        done = subprocess.run(
            [sys.executable, "-m", "pipeline", *arguments],
            cwd=self.folder,
            text=True,
            capture_output=True,
            timeout=LONGEST_S,
            env={**os.environ, "PYTHONPATH": str(CONFIG_DIR.parent)},
        )
        assert done.returncode == status, done.stderr
        return done.stdout, done.stderr


def result(folder: Path) -> dict:
    """metrics.json without what depends on the machine's speed and the clock."""
    metrics = json.loads((folder / "metrics.json").read_text())
    for name in ("date", "train_seconds", "train_cpu_seconds", "peak_rss_mb", "cpu"):
        del metrics[name]
    for model in ("final", "best_on_test"):
        for name in ("fps_raster", "fps_render"):
            del metrics[model][name]
    return metrics
