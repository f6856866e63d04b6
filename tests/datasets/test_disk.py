"""A disk that fills: the old file stays whole, and one line names the new one. The kernel itself refuses the bytes, by a
limit on the size of files (RLIMIT_FSIZE), which fails writes as a full disk does."""

from __future__ import annotations

import errno
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from shell import Shell

from datasets.files.atomic_folder import atomic_folder
from datasets.files.atomic_write import DiskFull, atomic_file, write_text, writing
from pipeline.config.compose import CONFIG_DIR

LIMITED = """
import resource, runpy, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))
sys.argv = {argv}
runpy.run_module("pipeline", run_name="__main__")
"""
TINY = (
    "scene=synthetic/wheel",
    "train=smoke",
    "scene.size=48",
    "scene.train_views=8",
    "scene.test_views=3",
    "threads=1",
    "evaluate.lpips=false",
    "out=run",
)


def limited(folder: Path, limit: int, *arguments: str) -> subprocess.CompletedProcess[str]:
    """`python -m pipeline` that may write no file of more than `limit` bytes."""
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
def begun(tmp_path_factory) -> Path:
    """A folder with a run of 20 iterations, whose checkpoint a longer run would replace."""
    folder = tmp_path_factory.mktemp("disk")
    Shell(folder)(*TINY, "train.iterations=20")
    return folder


def test_a_disk_that_fills_while_the_model_is_initialised(begun: Path) -> None:
    done = limited(begun, 100_000, *TINY, "out=other")  # init.ply is larger, all before it smaller
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert done.stderr.startswith("error: other/init.ply: expected room to write it, found no space left (")
    assert done.stderr.count("\n") == 1 and "make room and give the same command again" in done.stderr
    assert not list((begun / "other").glob(".tmp-*")) and not (begun / "other/init.ply").exists()


def test_a_disk_that_fills_while_a_checkpoint_is_written(begun: Path) -> None:
    size = (begun / "run/init.ply").stat().st_size
    done = limited(begun, 2 * size, *TINY, "out=third")  # a checkpoint holds Adam's moments besides
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert done.stderr.startswith("error: third/checkpoint.safetensors: expected room to write it, found no space left")
    assert done.stderr.count("\n") == 1
    assert {path.name for path in (begun / "third").iterdir()} == {
        ".lock",
        "config.yaml",
        "environment.json",
        "stages.json",
        "log.jsonl",
        "init.ply",
        "error_vs_time.csv",
    }
    Shell(begun)(*TINY, "out=third")  # with room again it goes on


def test_the_old_checkpoint_stays_whole(begun: Path) -> None:
    path = begun / "run" / "checkpoint.safetensors"
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


def test_an_error_without_a_name_gets_one(tmp_path: Path) -> None:
    with pytest.raises(DiskFull, match=rf"{tmp_path}/a: expected room"), writing(tmp_path / "a"):
        raise OSError(errno.ENOSPC, "No space left on device")
    with pytest.raises(OSError, match=rf"Input/output error: '{tmp_path}/a'"), writing(tmp_path / "a"):
        raise OSError(errno.EIO, "Input/output error")
    with pytest.raises(DiskFull, match="scene: expected room"), atomic_folder(tmp_path / "scene") as draft:
        np.save(draft / "a.npy", np.zeros(3))
        raise OSError(errno.ENOSPC, "No space left on device")
    assert list(tmp_path.iterdir()) == []


def test_replacing_keeps_the_old_file_and_leaves_nothing_beside_it(tmp_path: Path) -> None:
    write_text(tmp_path / "a", "old")
    with pytest.raises(ZeroDivisionError), atomic_file(tmp_path / "a") as temporary:
        temporary.write_text("half of")
        1 / 0
    assert (tmp_path / "a").read_text() == "old" and list(tmp_path.iterdir()) == [tmp_path / "a"]
