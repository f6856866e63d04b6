"""Atomic writes on a full disk: the old file is kept, and one line names the new one.

A limit on the size of files (RLIMIT_FSIZE) makes writes fail like a full disk.
"""

from __future__ import annotations

import errno
from pathlib import Path

import numpy as np
import pytest
from shell import FORKING, TINY, Shell, limit_files

from datasets.files.atomic_write import DiskFull, atomic_file, atomic_folder, disk_errors_named, write_text
from datasets.files.claim import HIDDEN
from pipeline.training import checkpoint

COMMAND = (*TINY, "out=run")


@pytest.fixture(scope="module")
def completed_run(tmp_path_factory) -> Path:
    """A folder with a run of 20 iterations."""
    folder = tmp_path_factory.mktemp("disk")
    Shell(folder)(*COMMAND, "train.iterations=20")
    return folder


def test_full_disk_while_init_ply_is_written(completed_run: Path) -> None:
    _, err = Shell(completed_run)(*COMMAND, "out=other", status=1, largest_file=100_000)  # only init.ply is larger
    assert err.startswith("error: other/init.ply: expected room to write it, found no space left (")
    assert err.count("\n") == 1 and "make room and give the same command again" in err
    assert not list((completed_run / "other").glob(".tmp-*")) and not (completed_run / "other/init.ply").exists()


def test_full_disk_while_a_checkpoint_is_written(completed_run: Path) -> None:
    size = (completed_run / "run/init.ply").stat().st_size
    # The checkpoint is larger: it also holds Adam's moments.
    _, err = Shell(completed_run)(*COMMAND, "out=third", status=1, largest_file=2 * size)
    assert err.startswith("error: third/checkpoint.safetensors: expected room to write it, found no space left")
    assert err.count("\n") == 1
    names = {path.name for path in (completed_run / "third").iterdir() if not path.name.startswith(HIDDEN)}
    assert names == {
        "config.yaml",
        "environment.json",
        "stages.json",
        "log.jsonl",
        "init.ply",
        "scene.json",
        "error_vs_time.csv",
    }
    Shell(completed_run)(*COMMAND, "out=third")  # with space again the run continues


def save_on_a_full_disk(path: Path, found: Path) -> None:
    """Writes the checkpoint `path` once more, with no room for it; the error's name goes to `found`."""
    saved = checkpoint.load(path)
    limit_files(10_000)
    try:
        checkpoint.save(path, saved)
    except DiskFull as error:
        found.write_text(type(error).__name__)


def test_full_disk_keeps_the_old_checkpoint(completed_run: Path, tmp_path: Path) -> None:
    path = completed_run / "run" / "checkpoint.safetensors"
    before = path.read_bytes()
    process = FORKING.Process(target=save_on_a_full_disk, args=(path, tmp_path / "found"))
    process.start()
    process.join(120)
    assert (process.exitcode, (tmp_path / "found").read_text()) == (0, "DiskFull")
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
