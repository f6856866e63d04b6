"""Atomic writes on a full disk: the old file is kept, and one line names the new one.

A limit on the size of files (RLIMIT_FSIZE) makes writes fail like a full disk.
"""

from __future__ import annotations

import errno
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from shell import TINY, Shell

from datasets.files.atomic_write import DiskFull, atomic_file, atomic_folder, disk_errors_named, write_text
from pipeline.config.compose import CONFIG_DIR

LIMITED = """
import resource, runpy, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))
sys.argv = {argv}
runpy.run_module("pipeline", run_name="__main__")
"""
COMMAND = (*TINY, "out=run")


def limited(folder: Path, limit: int, *arguments: str) -> subprocess.CompletedProcess[str]:
    """`python -m pipeline` with a limit of `limit` bytes per file."""
    code = LIMITED.format(limit=limit, argv=["pipeline", *arguments])
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        env={"PYTHONPATH": str(CONFIG_DIR.parent), "OMP_NUM_THREADS": "1", "PATH": "", "PYTHONDONTWRITEBYTECODE": "1"},
    )


@pytest.fixture(scope="module")
def completed_run(tmp_path_factory) -> Path:
    """A folder with a run of 20 iterations."""
    folder = tmp_path_factory.mktemp("disk")
    Shell(folder)(*COMMAND, "train.iterations=20")
    return folder


def test_full_disk_while_init_ply_is_written(completed_run: Path) -> None:
    done = limited(completed_run, 100_000, *COMMAND, "out=other")  # only init.ply is larger
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert done.stderr.startswith("error: other/init.ply: expected room to write it, found no space left (")
    assert done.stderr.count("\n") == 1 and "make room and give the same command again" in done.stderr
    assert not list((completed_run / "other").glob(".tmp-*")) and not (completed_run / "other/init.ply").exists()


def test_full_disk_while_a_checkpoint_is_written(completed_run: Path) -> None:
    size = (completed_run / "run/init.ply").stat().st_size
    done = limited(
        completed_run, 2 * size, *COMMAND, "out=third"
    )  # the checkpoint is larger: it also holds Adam's moments
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert done.stderr.startswith("error: third/checkpoint.safetensors: expected room to write it, found no space left")
    assert done.stderr.count("\n") == 1
    assert {path.name for path in (completed_run / "third").iterdir()} == {
        ".lock",
        "config.yaml",
        "environment.json",
        "stages.json",
        "log.jsonl",
        "init.ply",
        "error_vs_time.csv",
    }
    Shell(completed_run)(*COMMAND, "out=third")  # with space again the run continues


def test_full_disk_keeps_the_old_checkpoint(completed_run: Path) -> None:
    path = completed_run / "run" / "checkpoint.safetensors"
    before = path.read_bytes()
    from pipeline.training import checkpoint

    code = f"""
import resource, signal
from pathlib import Path
from pipeline.training import checkpoint
saved = checkpoint.load(Path({str(path)!r}))
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
checkpoint.save(Path({str(path)!r}), saved)
"""
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=120,
        env={"PYTHONPATH": str(CONFIG_DIR.parent), "PYTHONDONTWRITEBYTECODE": "1"},
    )
    assert "datasets.files.atomic_write.DiskFull: " in done.stderr
    assert path.read_bytes() == before and not list(path.parent.glob(".tmp-*"))
    assert checkpoint.load(path).iteration == checkpoint.saved_iteration(path) == 20


def test_disk_errors_name_the_path(tmp_path: Path) -> None:
    with pytest.raises(DiskFull, match=rf"{tmp_path}/a: expected room"), disk_errors_named(tmp_path / "a"):
        raise OSError(errno.ENOSPC, "No space left on device")
    with pytest.raises(OSError, match=rf"Input/output error: '{tmp_path}/a'"), disk_errors_named(tmp_path / "a"):
        raise OSError(errno.EIO, "Input/output error")
    with pytest.raises(DiskFull, match="scene: expected room"), atomic_folder(tmp_path / "scene", "a") as temporary:
        np.save(temporary / "a.npy", np.zeros(3))
        raise OSError(errno.ENOSPC, "No space left on device")
    assert list(tmp_path.iterdir()) == []


def test_an_exception_keeps_the_old_file_and_deletes_the_temporary_one(tmp_path: Path) -> None:
    write_text(tmp_path / "a", "old")
    with pytest.raises(ZeroDivisionError), atomic_file(tmp_path / "a") as temporary:
        temporary.write_text("half of")
        raise ZeroDivisionError
    assert (tmp_path / "a").read_text() == "old" and list(tmp_path.iterdir()) == [tmp_path / "a"]
