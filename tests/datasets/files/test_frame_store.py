"""The store of decoded frames: random access, detection of damage, constant memory."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from datasets.files.errors import SceneError
from datasets.files.frame_store import StoredFrame, read_frames, write_frames
from datasets.scene import Scene, View, camera_extent, validate_scene
from rasterizer.camera import Camera

SHAPE = (5, 7, 11, 3)  # frames of 231 bytes, which are not aligned to pages


@pytest.fixture
def images() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, SHAPE, dtype=np.uint8)


def store(folder: Path, images: np.ndarray) -> tuple[StoredFrame, ...]:
    write_frames(folder, "cam00", images.shape, iter(images), {"source": "cam00.mp4"})
    return read_frames(folder, "cam00", images.shape)


def test_random_access_reads_the_written_frames(tmp_path: Path, images: np.ndarray) -> None:
    frames = store(tmp_path, images)
    for index in (3, 0, 4, 1, 2, 3):
        assert np.array_equal(np.asarray(frames[index]), images[index])
        assert frames[index].checksum == f"{zlib.crc32(images[index].tobytes()):08x}"
    assert (frames[0].shape, frames[0].dtype) == ((7, 11, 3), np.uint8)


def test_file_is_a_plain_array_with_its_source(tmp_path: Path, images: np.ndarray) -> None:
    store(tmp_path, images)
    assert np.array_equal(np.load(tmp_path / "cam00.npy"), images)
    assert json.loads((tmp_path / "cam00.json").read_text())["source"] == "cam00.mp4"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cam00.json", "cam00.npy"]  # no temporary files


def test_read_returns_a_copy(tmp_path: Path, images: np.ndarray) -> None:
    frame = store(tmp_path, images)[0]
    np.asarray(frame)[:] = 0
    assert np.array_equal(np.asarray(frame), images[0])
    assert np.asarray(frame, dtype=np.float32).dtype == np.float32
    with pytest.raises(ValueError, match="copy must not be False"):
        np.array(frame, copy=False)


def test_pickled_frame_can_be_read(tmp_path: Path, images: np.ndarray) -> None:
    frame = store(tmp_path, images)[2]
    np.asarray(frame)  # opens the map, which cannot be pickled
    assert np.array_equal(np.asarray(pickle.loads(pickle.dumps(frame))), images[2])


def test_reads_are_thread_safe(tmp_path: Path, images: np.ndarray) -> None:
    frames = store(tmp_path, images)
    order = np.random.default_rng(1).integers(0, SHAPE[0], 400)
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda index: np.asarray(frames[index]), order))
    assert all(np.array_equal(image, images[index]) for index, image in zip(order, found))


# --- damage -----------------------------------------------------------------------------------------------------------


def test_wrong_checksum_is_refused(tmp_path: Path, images: np.ndarray) -> None:
    frames = store(tmp_path, images)
    path = tmp_path / "cam00.npy"
    content = bytearray(path.read_bytes())
    content[-231] ^= 1  # the first byte of the last frame
    path.write_bytes(content)
    assert np.array_equal(np.asarray(frames[3]), images[3])  # the others are valid
    with pytest.raises(
        SceneError,
        match=rf"cam00\.npy: frame 4: expected the checksum {frames[4].checksum}, found "
        rf"[0-9a-f]+; delete the folder {tmp_path} and run again",
    ) as caught:
        np.asarray(frames[4])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "damage",
    [
        lambda folder: (folder / "cam00.npy").unlink(),
        lambda folder: (folder / "cam00.json").unlink(),
        lambda folder: (folder / "cam00.npy").write_bytes((folder / "cam00.npy").read_bytes()[:-1]),
        lambda folder: (folder / "cam00.json").write_text('{"offset": 128, "chec'),
        lambda folder: (folder / "cam00.json").write_text("[]"),
        lambda folder: (folder / "cam00.json").write_text('{"offset": 128, "checksums": [], "shape": [5, 7, 11, 3]}'),
    ],
)
def test_incomplete_store_reads_as_none(tmp_path: Path, images: np.ndarray, damage) -> None:
    store(tmp_path, images)
    damage(tmp_path)
    assert read_frames(tmp_path, "cam00", SHAPE) is None


def test_store_of_another_shape_reads_as_none(tmp_path: Path, images: np.ndarray) -> None:
    store(tmp_path, images)
    assert read_frames(tmp_path, "cam00", (4, *SHAPE[1:])) is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda images: images[:4], "expected 5 frames, got 4"),
        (lambda images: images[:, :6], r"must be uint8 \(7, 11, 3\), got uint8 \(6, 11, 3\)"),
        (lambda images: images.astype(np.int16), "got int16"),
    ],
)
def test_wrong_frames_are_refused_and_leave_no_files(tmp_path: Path, images: np.ndarray, change, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        write_frames(tmp_path, "cam00", SHAPE, change(images), {})
    assert not list(tmp_path.iterdir())


# --- size -------------------------------------------------------------------------------------------------------------

MEMORY = """
import sys, numpy as np
from pathlib import Path
from datasets.files.frame_store import read_frames
def status(): return {k: int(v.split()[0]) / 1000 for k, v in
                      (line.split(":") for line in open("/proc/self/status")) if k in ("VmRSS", "RssFile")}
frames = read_frames(Path(sys.argv[1]), "cam00", (75, 1000, 1333, 3))
np.asarray(frames[0])
before, most = status(), {"VmRSS": 0, "RssFile": 0}
for frame in frames:
    np.asarray(frame).max()
    most = {key: max(most[key], value) for key, value in status().items()}
print(*(most[key] - before[key] for key in most))
"""


def test_reading_does_not_increase_resident_memory(tmp_path: Path) -> None:
    shape = (75, 1000, 1333, 3)
    frame = np.zeros(shape[1:], dtype=np.uint8)
    write_frames(tmp_path, "cam00", shape, (frame for _ in range(shape[0])), {})
    ran = subprocess.run([sys.executable, "-c", MEMORY, str(tmp_path)], capture_output=True, text=True, check=True)
    (tmp_path / "cam00.npy").unlink()
    # Increase in MB of all resident memory and of mapped files: one or two frames of 4 MB each, not 300 MB.
    assert all(float(grown) < 20 for grown in ran.stdout.split()), ran.stdout


def test_validate_scene_reads_no_frame(tmp_path: Path) -> None:
    shape = (300, 4, 6, 3)
    views = []
    for number in range(20):
        write_frames(tmp_path, f"cam{number:02d}", shape, np.zeros(shape, dtype=np.uint8), {})
        pose = np.eye(4)
        pose[0, 3] = number
        camera = Camera(6, 4, 5.0, 5.0, 3.0, 2.0, pose)
        frames = read_frames(tmp_path, f"cam{number:02d}", shape)
        (tmp_path / f"cam{number:02d}.npy").unlink()  # reading a frame would fail
        views += [
            View(camera, index / 30, frame, f"train/cam{number:02d}_{index:04d}") for index, frame in enumerate(frames)
        ]
    extent = camera_extent([view.camera for view in views])
    scene = Scene(
        "toy",
        tuple(views[300:]),
        tuple(views[:300]),
        10.0,
        0.0,
        (0.0, 0.0, 0.0),
        extent,
        (-1.0, 1.0),
        tmp_path,
        "monocular",
    )
    assert validate_scene(scene) is scene
