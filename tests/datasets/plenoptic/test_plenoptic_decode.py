"""Decoding into the store: caching, resuming, locking, full disks, display, undistortion."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from io import StringIO
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import plenoptic_folder
import pytest
from plenoptic_folder import FRAMES, write_camera
from rich.console import Console

from datasets.cameras.lens import Undistortion
from datasets.files.claim import Claim
from datasets.files.errors import SceneError
from datasets.files.fingerprint import fingerprint
from datasets.plenoptic import decode as decoding
from datasets.plenoptic.align import FilmStream
from datasets.plenoptic.display import DecodingDisplay
from datasets.scene import Scene
from rasterizer.camera import Camera


@pytest.fixture
def folder(video_folder: Path, tmp_path: Path) -> Path:
    return shutil.copytree(video_folder, tmp_path / "scene")


def read(folder: Path, cache: str = "cache", **options: object) -> Scene:
    return plenoptic_folder.read(folder, cache=folder.parent / cache, **{"downscale": 2, "threads": 1, **options})


def pixels(scene: Scene) -> np.ndarray:
    return np.stack([np.asarray(view.image) for view in scene.train + scene.test])


def store_of(folder: Path, cache: str = "cache") -> Path:
    (store,) = (folder.parent / cache).glob("plenoptic_*")
    return store


def modification_times(store: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in store.glob("cam*")}


# --- caching ----------------------------------------------------------------------------------------------------------


def test_second_read_decodes_nothing(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = pixels(read(folder))
    monkeypatch.setattr(FilmStream, "read", None)  # decoding would fail
    assert np.array_equal(pixels(read(folder)), first)
    assert store_of(folder).name.startswith("plenoptic_toy-")


def test_store_depends_on_content_not_on_path(folder: Path) -> None:
    read(folder)
    store = store_of(folder)
    copy = Path(
        shutil.copytree(folder, folder.parent / "copy", copy_function=shutil.copyfile)
    )  # with new modification times
    read(copy)
    assert [store] == list((folder.parent / "cache").glob("[!f]*"))
    write_camera(copy / "cam02.mp4", 7)
    read(copy)
    assert len(list((folder.parent / "cache").glob("[!f]*"))) == 2


@pytest.mark.parametrize("option", [{"downscale": 4}, {"first_frame": 1}, {"frames": FRAMES - 1}, {"name": "other"}])
def test_store_depends_on_settings_of_frames(folder: Path, option: dict) -> None:
    read(folder)
    read(folder, **option)
    assert len(list((folder.parent / "cache").glob("[!f]*"))) == 2


def test_store_does_not_depend_on_poses_and_splits(folder: Path) -> None:
    read(folder)
    np.save(folder / "poses_bounds.npy", np.load(folder / "poses_bounds.npy") * ([1] * 15 + [1.5, 2]))
    read(folder, test_cameras=[1])
    store_of(folder)  # exactly one


def test_fingerprint_covers_name_size_and_both_ends(tmp_path: Path) -> None:
    path = tmp_path / "a"
    found = set()
    for content in (b"0123456789", b"x123456789", b"012345678x", b"01234x56789"):
        path.write_bytes(content)
        found.add(fingerprint([path], 2))
    found.add(fingerprint([path.rename(tmp_path / "b")], 2))
    assert len(found) == 5
    with pytest.raises(SceneError, match="a: expected a readable file, found .*No such file"):
        fingerprint([tmp_path / "a"], 2)


# --- interruptions ----------------------------------------------------------------------------------------------------

KILLED = """
import sys, time
from datasets.source import open_source
from datasets.plenoptic.align import FilmStream
from datasets.settings import SceneConfig
original = FilmStream.read
def slow(self, *arguments):
    for index, image in enumerate(original(self, *arguments)):
        if self.number == 1 and index == 3:
            print("in the middle of camera 1", flush=True)
            time.sleep(60)
        yield image
FilmStream.read = slow
cfg = SceneConfig("plenoptic/toy", "plenoptic", sys.argv[1], cache=sys.argv[2])
open_source(cfg, threads=1, log=lambda text: None).scene()
"""


def test_killed_run_is_resumed(folder: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(folder), str(folder.parent / "cache")], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "in the middle of camera 1\n"
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    store = store_of(folder)
    assert (store / ".tmp-cam01.npy").exists() and not (store / "cam01.json").exists()
    before = modification_times(store)
    assert set(before) == {"cam00.npy", "cam00.json"}
    scene = read(folder)
    assert {name: date for name, date in modification_times(store).items() if name in before} == before
    assert not list(store.glob(".tmp-*"))
    assert np.array_equal(pixels(scene), pixels(read(folder, "other_cache")))


def test_an_error_stops_other_threads_and_keeps_finished_cameras(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    original, started = FilmStream.read, threading.Event()

    def failing_read(self: FilmStream, *arguments: int) -> Iterator[np.ndarray]:
        if self.number == 1:
            assert started.wait(30)
            raise SceneError(self.path, "x", "y")
        for index, image in enumerate(original(self, *arguments)):
            if self.number == 2 and index == 1:
                started.set()
                time.sleep(0.2)  # camera 1 fails meanwhile
            yield image

    monkeypatch.setattr(FilmStream, "read", failing_read)
    with pytest.raises(SceneError, match="cam01.mp4: expected x, found y"):
        read(folder, threads=3)
    store = store_of(folder)
    assert "cam02.npy" not in modification_times(store) and not list(store.glob(".tmp-*"))
    monkeypatch.setattr(FilmStream, "read", original)
    assert np.array_equal(pixels(read(folder)), pixels(read(folder, "other_cache")))


def test_truncated_file_is_decoded_again(folder: Path) -> None:
    first = pixels(read(folder))
    store = store_of(folder)
    os.truncate(store / "cam01.npy", 1000)
    before = modification_times(store)
    assert np.array_equal(pixels(read(folder)), first)
    assert {name for name, date in modification_times(store).items() if date != before[name]} == {
        "cam01.npy",
        "cam01.json",
    }


def test_second_process_waits_for_the_lock(folder: Path) -> None:
    read(folder)
    store = store_of(folder)
    (store / "cam01.json").rename(folder.parent / "kept.json")
    logged = []
    with Claim(store):
        other = threading.Thread(target=lambda: read(folder, log=logged.append))
        other.start()
        for _ in range(300):
            if logged:
                break
            time.sleep(0.02)
        before = modification_times(store)
        (folder.parent / "kept.json").rename(store / "cam01.json")  # the result of the first process
    other.join(30)
    assert logged == [f"waiting for another process that decodes into {store}"]
    assert {name: date for name, date in modification_times(store).items() if name in before} == before


# --- disk space -------------------------------------------------------------------------------------------------------


def test_full_disk_is_detected_before_decoding(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decoding.shutil, "disk_usage", lambda path: SimpleNamespace(free=10_000))
    with pytest.raises(
        SceneError,
        match=r"plenoptic_toy-\w+: expected 0\.0 GB free for the decoded frames, found "
        r"0\.0 GB; scene\.cache=DIR puts them elsewhere",
    ) as caught:
        read(folder)
    assert "\n" not in str(caught.value) and not modification_times(store_of(folder))


def test_required_space_is_that_of_missing_cameras(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read(folder)
    for file in ("cam01.json", "cam02.json"):
        (store_of(folder) / file).unlink()
    needed = 2 * FRAMES * 24 * 32 * 3
    monkeypatch.setattr(decoding.shutil, "disk_usage", lambda path: SimpleNamespace(free=needed - 1))
    with pytest.raises(SceneError, match="free for the decoded frames"):
        read(folder)
    monkeypatch.setattr(decoding.shutil, "disk_usage", lambda path: SimpleNamespace(free=needed))
    read(folder)


def test_full_disk_while_decoding(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*arguments: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(np.lib.format, "write_array_header_1_0", full)
    with pytest.raises(SceneError, match="GB free for the decoded frames, found .* GB; scene.cache=DIR"):
        read(folder)


# --- display ----------------------------------------------------------------------------------------------------------


def test_one_line_per_camera_without_a_terminal(folder: Path) -> None:
    logged = []
    read(folder, log=logged.append)
    assert [line.split("  ")[0] for line in logged] == [
        f"decoded {name}: {number} of 3 cameras" for number, name in enumerate(("cam00", "cam01", "cam02"), 1)
    ]
    assert logged[-1].endswith("0:00 left")
    logged.clear()
    read(folder, log=logged.append)
    assert not logged


def test_progress_bar_on_a_terminal() -> None:
    logged, screen = [], StringIO()
    console = Console(file=screen, force_terminal=True, width=80)
    with DecodingDisplay(1, 2, logged.append, console) as display:
        display.frame()
        display.frame()
        display.camera("cam00")
    assert "2/2" in screen.getvalue() and "frames/s" in screen.getvalue() and not logged


# --- undistortion -----------------------------------------------------------------------------------------------------


def test_undistortion_maps_follow_opencvs_model() -> None:
    camera = Camera(64, 48, 50.0, 55.0, 30.0, 25.0, np.eye(4))
    k1, k2, p1, p2 = -0.1, 0.02, 0.003, -0.004
    maps = Undistortion.of(camera, k1, k2, p1, p2).maps((64, 48))
    columns, rows = np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5)  # our pixels' centres
    x, y = (columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2
    distorted_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    distorted_y = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    expected = np.dstack([distorted_x * camera.fx + camera.cx, distorted_y * camera.fy + camera.cy])
    # The values of this image are its coordinates.
    ramp = np.dstack([columns, rows]).astype(np.float32)
    found = cv2.remap(ramp, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    inside = (expected > 1).all(axis=-1) & (expected < [63, 47]).all(axis=-1)
    assert inside.mean() > 0.8
    np.testing.assert_allclose(found[inside], expected[inside], atol=1 / 32)  # OpenCV's fixed-point maps: 1/32 pixel
