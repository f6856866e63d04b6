"""The Plenoptic Video reader on small videos: frames, times, cameras and splits."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from plenoptic_folder import FOCAL, FRAMES, HEIGHT, NEAR, RATE, WIDTH, inside, picture, read, write_camera, write_folder

from datasets.files.frame_store import StoredFrame
from datasets.settings import SceneConfig
from datasets.source import detect, open_source

# Levels of 255, inside a block: 1 to 2 from limited range, the rest from x264 at crf 1.
CODEC = 4


@pytest.fixture
def folder(video_folder: Path, tmp_path: Path) -> Path:
    return shutil.copytree(video_folder, tmp_path / "scene")


def test_frames_in_order_and_rgb(folder: Path) -> None:
    scene = read(folder)
    assert len(scene.train) == 2 * FRAMES and len(scene.test) == FRAMES
    for view in scene.train + scene.test:
        camera, frame = view.name.split("/cam")[1].split("_")
        truth = picture(int(camera), int(frame))
        assert isinstance(view.image, StoredFrame)
        error = np.abs(inside(np.asarray(view.image)).astype(int) - inside(truth))
        assert error.max() <= CODEC, view.name


def test_view_names_times_and_splits(folder: Path) -> None:
    scene = read(folder)
    assert [view.name for view in scene.test] == [f"test/cam00_{frame:04d}" for frame in range(FRAMES)]
    assert scene.train[0].name == "train/cam01_0000" and scene.train[-1].name == f"train/cam02_{FRAMES - 1:04d}"
    assert [view.time for view in scene.test] == pytest.approx([frame / RATE for frame in range(FRAMES)], rel=1e-12)
    assert (scene.time_start, scene.duration, scene.frame_rate) == (0.0, pytest.approx(FRAMES / RATE), RATE)
    assert scene.capture == "multi_view" and scene.source == folder and scene.background == (0.0, 0.0, 0.0)


def test_cameras_are_those_of_poses_bounds(folder: Path) -> None:
    scene = read(folder)
    camera = scene.train[0].camera
    assert (camera.width, camera.height, camera.fx, camera.fy) == (WIDTH, HEIGHT, FOCAL, FOCAL)
    assert (camera.cx, camera.cy) == (WIDTH / 2, HEIGHT / 2)
    np.testing.assert_allclose(camera.position, [1, 0, -4], atol=1e-12)
    assert scene.unit == 0.75 * NEAR
    assert scene.extent == pytest.approx(1.1 * 0.5)  # training cameras at x = 1 and 2
    low, high = scene.init_box
    assert low[2] <= -4 and high[2] >= 6  # the cameras, and z = -4 + 10 at their far bound


def test_downscale_averages_blocks_and_scales_cameras(folder: Path) -> None:
    full, half = read(folder), read(folder, downscale=2)
    for a, b in zip(full.test, half.test):
        blocks = np.asarray(a.image, dtype=float).reshape(HEIGHT // 2, 2, WIDTH // 2, 2, 3).mean(axis=(1, 3))
        np.testing.assert_allclose(np.asarray(b.image), blocks, atol=0.5)  # rounded once
    camera = half.test[0].camera
    assert (camera.width, camera.height, camera.fx, camera.cx) == (WIDTH // 2, HEIGHT // 2, FOCAL / 2, WIDTH / 4)


def test_incomplete_blocks_are_cropped_from_image_and_camera(folder: Path) -> None:
    full, fifth = read(folder), read(folder, downscale=5)  # 64 = 12 · 5 + 4, 48 = 9 · 5 + 3
    whole = np.asarray(full.test[0].image, dtype=float)[:45, :60].reshape(9, 5, 12, 5, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(np.asarray(fifth.test[0].image), whole, atol=0.501)
    camera = fifth.test[0].camera
    assert (camera.width, camera.height) == (12, 9)
    assert (camera.cx, camera.cy) == pytest.approx(
        (WIDTH / 2 / 5, HEIGHT / 2 / 5)
    )  # not the centre of the cropped image


def test_first_frame_and_frames(folder: Path) -> None:
    everything, some = read(folder), read(folder, first_frame=2, frames=3)
    assert [view.name for view in some.test] == ["test/cam00_0002", "test/cam00_0003", "test/cam00_0004"]
    assert [view.time for view in some.test] == pytest.approx([0, 1 / RATE, 2 / RATE])
    assert some.duration == pytest.approx(3 / RATE)
    for found, view in zip(some.test, everything.test[2:]):
        assert np.array_equal(np.asarray(found.image), np.asarray(view.image))


def test_dropping_and_holding_out_cameras_reuses_the_store(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "scene", (0, 1, 2, 3))
    read(folder)
    (store,) = (folder.parent / "cache").glob("plenoptic_*")
    written = {path: path.stat().st_mtime_ns for path in store.glob("cam*")}
    scene = read(folder, test_cameras=[2], drop_cameras=[0])
    assert {view.name[:11] for view in scene.train} == {"train/cam01", "train/cam03"}
    assert {view.name[:10] for view in scene.test} == {"test/cam02"}
    assert {path: path.stat().st_mtime_ns for path in store.glob("cam*")} == written


def test_camera_numbers_with_gaps(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "scene", (1, 4, 10))
    scene = read(folder, test_cameras=[4])
    assert {view.name[:10] for view in scene.test} == {"test/cam04"}
    np.testing.assert_allclose(scene.test[0].camera.position, [4, 0, -4], atol=1e-12)
    np.testing.assert_allclose(scene.train[-1].camera.position, [10, 0, -4], atol=1e-12)


@pytest.mark.parametrize("name", ["CAM{:02d}.MP4", "cam_{:02d}.mp4"])
def test_names_may_differ_in_case_and_have_an_underscore(folder: Path, name: str) -> None:
    for number in range(3):
        (folder / f"cam{number:02d}.mp4").rename(folder / name.format(number))
    assert detect(folder)[0] == "plenoptic"
    scene = read(folder, test_cameras=[1])
    stem = name.format(1)[:-4]
    assert [view.name for view in scene.test] == [f"test/{stem}_{frame:04d}" for frame in range(FRAMES)]
    np.testing.assert_allclose(scene.test[0].camera.position, [1, 0, -4], atol=1e-12)


def test_poses_that_are_not_used_are_named(folder: Path) -> None:
    unused = "poses_bounds.npy is there and not used: the videos are not called cam00.mp4"
    assert unused not in detect(folder)[1]
    for number in range(3):
        (folder / f"cam{number:02d}.mp4").rename(folder / f"{number:02d}.mp4")
    reader, line = detect(folder)
    assert reader == "video" and unused in line and "\n" not in line
    (folder / "images").mkdir()  # whose poses they are
    cv2.imwrite(str(folder / "images" / "0.png"), picture(0, 0))
    reader, line = detect(folder)
    assert reader == "llff" and unused not in line


def test_videos_of_different_lengths_with_enough_common_frames(folder: Path) -> None:
    write_camera(folder / "cam02.mp4", 2, FRAMES + 2)
    assert len(read(folder, frames=FRAMES).train) == 2 * FRAMES


def test_frame_rates_29_97_and_30_are_equal(folder: Path) -> None:
    write_camera(folder / "cam02.mp4", 2, FRAMES, 30_000 / 1001)
    assert len(read(folder).train) == 2 * FRAMES


@pytest.mark.parametrize("reader", ["plenoptic", "synthetic"])
def test_scene_by_config(folder: Path, reader: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if reader == "synthetic":
        import datasets.synthetic as synthetic

        def make_scene(name: str, cache: str, **options: object) -> Path:
            assert (name, options["cameras"], options["frames"], options["size"]) == ("counter", 3, FRAMES, WIDTH)
            return folder

        monkeypatch.setattr(synthetic, "make_scene", make_scene)
    name = {"plenoptic": "plenoptic", "synthetic": "synthetic/counter"}[reader]
    path = str(folder) if reader == "plenoptic" else None
    cfg = SceneConfig(
        name=name,
        reader=reader,
        path=path,
        cache=str(folder.parent / "cache"),
        downscale=2,
        cameras=3,
        size=WIDTH,
        frames=FRAMES,
        test_cameras=[1],
    )
    scene = open_source(cfg, log=lambda text: None).scene()
    assert scene.name == name and scene.train[0].image.shape == (HEIGHT // 2, WIDTH // 2, 3)
    assert {view.name[:10] for view in scene.test} == {"test/cam01"}


def test_codecs_are_imported_only_for_videos() -> None:
    code = """import sys, datasets, datasets.readers.dnerf, datasets.files.frame_store
assert 'cv2' not in sys.modules
import datasets.synthetic.__main__
assert 'imageio_ffmpeg' not in sys.modules"""
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
