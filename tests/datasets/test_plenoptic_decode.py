"""Decoding into the store: once, resumable, one process at a time, never onto a full disk; lenses straightened."""

from __future__ import annotations

import errno
import fcntl
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
import pytest
from plenoptic_folder import FRAMES, write_camera, write_folder
from rich.console import Console

from datasets import Scene, SceneError
from datasets.cameras.lens import Undistortion
from datasets.plenoptic import decode as decoding
from datasets.plenoptic import read_plenoptic
from datasets.plenoptic.decode import fingerprint
from datasets.plenoptic.display import DecodingDisplay
from datasets.plenoptic.videos import Video
from rasterizer.camera import Camera


@pytest.fixture(scope="session")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_folder(tmp_path_factory.mktemp("filmed"))


@pytest.fixture
def folder(filmed: Path, tmp_path: Path) -> Path:
    return shutil.copytree(filmed, tmp_path / "scene")


def read(folder: Path, cache: str = "cache", **options: object) -> Scene:
    given = dict(name="plenoptic/toy", cache=folder.parent / cache, threads=1, log=lambda text: None)
    return read_plenoptic(folder, **{**given, **options})


def pixels(scene: Scene) -> np.ndarray:
    return np.stack([np.asarray(view.image) for view in scene.train + scene.test])


def store_of(folder: Path, cache: str = "cache") -> Path:
    (store,) = (folder.parent / cache).iterdir()
    return store


def written(store: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in store.glob("cam*")}


# --- once -----------------------------------------------------------------------------------------------------------


def test_the_second_time_nothing_is_decoded(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = pixels(read(folder))
    monkeypatch.setattr(Video, "read", None)  # whoever decodes now fails
    assert np.array_equal(pixels(read(folder)), first)
    assert store_of(folder).name.startswith("plenoptic_toy-")


def test_a_copied_data_set_finds_its_frames_and_other_content_does_not(folder: Path) -> None:
    read(folder)
    store = store_of(folder)
    copy = Path(shutil.copytree(folder, folder.parent / "copy", copy_function=shutil.copyfile))  # with new dates
    read(copy)
    assert [store] == list((folder.parent / "cache").iterdir())
    write_camera(copy / "cam02.mp4", 7)
    read(copy)
    assert len(list((folder.parent / "cache").iterdir())) == 2


@pytest.mark.parametrize("option", [{"downscale": 4}, {"first_frame": 1}, {"frames": FRAMES - 1}, {"name": "other"}])
def test_what_frames_follow_from_names_the_store(folder: Path, option: dict) -> None:
    read(folder)
    read(folder, **option)
    assert len(list((folder.parent / "cache").iterdir())) == 2


def test_poses_and_splits_do_not_name_the_store(folder: Path) -> None:
    read(folder)
    np.save(folder / "poses_bounds.npy", np.load(folder / "poses_bounds.npy") * ([1] * 15 + [1.5, 2]))
    read(folder, test_cameras=[1])
    store_of(folder)  # there is one


def test_the_fingerprint_sees_both_ends_the_name_and_the_size(tmp_path: Path) -> None:
    path = tmp_path / "a"
    found = set()
    for content in (b"0123456789", b"x123456789", b"012345678x", b"01234x56789"):
        path.write_bytes(content)
        found.add(fingerprint([path], 2))
    found.add(fingerprint([path.rename(tmp_path / "b")], 2))
    assert len(found) == 5
    with pytest.raises(SceneError, match="a: expected a readable file, found .*No such file"):
        fingerprint([tmp_path / "a"], 2)


# --- interruptions --------------------------------------------------------------------------------------------------

KILLED = """
import sys, time
from datasets.plenoptic import read_plenoptic
from datasets.plenoptic.videos import Video
original = Video.read
def slow(self, *arguments):
    for index, image in enumerate(original(self, *arguments)):
        if self.number == 1 and index == 3:
            print("in the middle of camera 1", flush=True)
            time.sleep(60)
        yield image
Video.read = slow
read_plenoptic(sys.argv[1], name="plenoptic/toy", cache=sys.argv[2], threads=1, log=lambda text: None)
"""


def test_a_killed_run_goes_on_where_it_stopped(folder: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(folder), str(folder.parent / "cache")], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "in the middle of camera 1\n"
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    store = store_of(folder)
    assert (store / ".tmp-cam01.npy").exists() and not (store / "cam01.json").exists()
    before = written(store)
    assert set(before) == {"cam00.npy", "cam00.json"}
    scene = read(folder)
    assert {name: date for name, date in written(store).items() if name in before} == before
    assert not list(store.glob(".tmp-*"))
    assert np.array_equal(pixels(scene), pixels(read(folder, "afresh")))


def test_an_error_stops_the_other_threads_and_keeps_what_is_finished(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    original, begun = Video.read, threading.Event()

    def read_badly(self: Video, *arguments: int) -> Iterator[np.ndarray]:
        if self.number == 1:
            assert begun.wait(30)
            raise SceneError(self.path, "a good day", "a bad one")
        for index, image in enumerate(original(self, *arguments)):
            if self.number == 2 and index == 1:
                begun.set()
                time.sleep(0.2)  # by then camera 1 has failed
            yield image

    monkeypatch.setattr(Video, "read", read_badly)
    with pytest.raises(SceneError, match="cam01.mp4: expected a good day, found a bad one"):
        read(folder, threads=3)
    store = store_of(folder)
    assert "cam02.npy" not in written(store) and not list(store.glob(".tmp-*"))
    monkeypatch.setattr(Video, "read", original)
    assert np.array_equal(pixels(read(folder)), pixels(read(folder, "afresh")))


def test_a_store_that_lost_a_part_is_made_whole(folder: Path) -> None:
    first = pixels(read(folder))
    store = store_of(folder)
    os.truncate(store / "cam01.npy", 1000)
    before = written(store)
    assert np.array_equal(pixels(read(folder)), first)
    assert {name for name, date in written(store).items() if date != before[name]} == {"cam01.npy", "cam01.json"}


def test_a_second_process_waits_and_finds_the_work_done(folder: Path) -> None:
    read(folder)
    store = store_of(folder)
    (store / "cam01.json").rename(folder.parent / "kept.json")
    said = []
    with open(store / ".lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        other = threading.Thread(target=lambda: read(folder, log=said.append))
        other.start()
        for _ in range(300):
            if said:
                break
            time.sleep(0.02)
        before = written(store)
        (folder.parent / "kept.json").rename(store / "cam01.json")  # what the first process does in the meantime
    other.join(30)
    assert said == [f"waiting for another process that decodes into {store}"]
    assert {name: date for name, date in written(store).items() if name in before} == before


# --- room -----------------------------------------------------------------------------------------------------------


def test_a_disk_without_room_is_found_before_decoding(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decoding.shutil, "disk_usage", lambda path: SimpleNamespace(free=10_000))
    with pytest.raises(
        SceneError,
        match=r"plenoptic_toy-\w+: expected 0\.0 GB free for the decoded frames, found "
        r"0\.0 GB; scene\.cache=DIR puts them elsewhere",
    ) as caught:
        read(folder)
    assert "\n" not in str(caught.value) and not written(store_of(folder))


def test_the_room_asked_for_is_that_of_the_missing_cameras(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read(folder)
    for file in ("cam01.json", "cam02.json"):
        (store_of(folder) / file).unlink()
    needed = 2 * FRAMES * 24 * 32 * 3
    monkeypatch.setattr(decoding.shutil, "disk_usage", lambda path: SimpleNamespace(free=needed - 1))
    with pytest.raises(SceneError, match="free for the decoded frames"):
        read(folder)
    monkeypatch.setattr(decoding.shutil, "disk_usage", lambda path: SimpleNamespace(free=needed))
    read(folder)


def test_a_disk_that_fills_up_meanwhile_says_the_same(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*arguments: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(np.lib.format, "write_array_header_1_0", full)
    with pytest.raises(SceneError, match="GB free for the decoded frames, found .* GB; scene.cache=DIR"):
        read(folder)


# --- what is shown --------------------------------------------------------------------------------------------------


def test_without_a_terminal_there_is_one_line_a_camera(folder: Path) -> None:
    said = []
    read(folder, log=said.append)
    assert [line.split("  ")[0] for line in said] == [
        f"decoded {name}: {number} of 3 cameras" for number, name in enumerate(("cam00", "cam01", "cam02"), 1)
    ]
    assert said[-1].endswith("0:00 left")
    said.clear()
    read(folder, log=said.append)
    assert not said


def test_on_a_terminal_there_is_a_bar_and_no_line() -> None:
    said, screen = [], StringIO()
    console = Console(file=screen, force_terminal=True, width=80)
    with DecodingDisplay(1, 2, said.append, console) as display:
        display.frame()
        display.frame()
        display.camera("cam00")
    assert "2/2" in screen.getvalue() and "frames/s" in screen.getvalue() and not said


# --- lenses ---------------------------------------------------------------------------------------------------------


def test_a_straight_image_is_taken_from_where_the_lens_put_it() -> None:
    camera = Camera(64, 48, 50.0, 55.0, 30.0, 25.0, np.eye(4))
    k1, k2, p1, p2 = -0.1, 0.02, 0.003, -0.004
    maps = Undistortion.of(camera, k1, k2, p1, p2).maps((64, 48))
    columns, rows = np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5)  # our pixels' centres
    x, y = (columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2
    bent_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    bent_y = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    seen = np.dstack([bent_x * camera.fx + camera.cx, bent_y * camera.fy + camera.cy])
    # An image whose values are its own coordinates shows where each pixel is taken from.
    ramp = np.dstack([columns, rows]).astype(np.float32)
    found = cv2.remap(ramp, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    inside = (seen > 1).all(axis=-1) & (seen < [63, 47]).all(axis=-1)
    assert inside.mean() > 0.8
    np.testing.assert_allclose(found[inside], seen[inside], atol=1 / 32)  # OpenCV's fixed-point maps: 1/32 pixel
