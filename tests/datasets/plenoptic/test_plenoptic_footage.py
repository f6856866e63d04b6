"""Videos without poses: which files are read, their first images, and the scene with given cameras."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from clips import textured_plane, write_clip
from plenoptic_folder import FRAMES, HEIGHT, RATE, WIDTH, inside, opened, picture, write_camera, write_folder

from datasets.cameras.lens import Undistortion
from datasets.files.errors import SceneError
from datasets.plenoptic.align import FilmStream
from datasets.plenoptic.footage import Footage
from datasets.readers.video import read_footage
from datasets.settings import SceneConfig
from datasets.source import open_source
from rasterizer.camera import Camera

NAMES = ("b.cam.mp4", "GX 03.mov", "left.MKV", "right.avi")
CODEC = 4  # see test_plenoptic_videos.py


@pytest.fixture(scope="session")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("footage")
    for number, name in enumerate(NAMES):
        write_camera(folder / name, number)
    for name in ("notes.txt", "._left.mp4"):
        (folder / name).write_text("not a video")
    return folder


def numbers(footage: Footage) -> tuple[int, ...]:
    return tuple(stream.number for stream in footage.streams)


def read(folder: Path, log: Callable[[str], None] = str, **options: object) -> Footage:
    given = {"name": "video/toy", "cache": folder.parent / "cache", "downscale": 2, **options}
    return read_footage(folder, SceneConfig(reader="video", **given), 2, log)


def cameras(footage: Footage) -> dict[str, Camera]:
    made = {}
    for number, name in zip(numbers(footage), footage.names):
        pose = np.eye(4)
        pose[:3, 3] = -number, 0, 4
        made[name] = Camera(WIDTH, HEIGHT, 50.0, 51.0, 31.0, 25.0, pose)
    return made


def test_videos_are_sorted_by_name(filmed: Path) -> None:
    footage = read(filmed, test_cameras=[2])
    assert footage.names == ("b.cam", "GX 03", "left", "right") and numbers(footage) == (0, 1, 2, 3)
    assert (footage.size, footage.rate, footage.count, footage.source) == ((WIDTH, HEIGHT), RATE, FRAMES, filmed)
    assert footage.held_out == ("left",)


def test_cameras_have_the_numbers_of_their_names_as_with_poses(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "scene", (1, 2, 10))
    for number in (1, 2):
        (folder / f"cam{number:02d}.mp4").rename(folder / f"cam{number}.mp4")
    lines: list[str] = []
    footage = read(folder, log=lines.append)
    assert (footage.names, numbers(footage)) == (("cam1", "cam2", "cam10"), (1, 2, 10))
    # The default of scene.test_cameras, [0], is none of them.
    assert footage.held_out == ("cam1",) and lines == [
        "no camera has the number 0: camera 1 is held out (scene.test_cameras)"
    ]
    assert read(folder, drop_cameras=[1]).held_out == ("cam2",)
    chosen = {"test_cameras": [2], "drop_cameras": [1]}
    posed = opened(folder, **chosen)
    footage = read(folder, **chosen)
    assert footage.held_out == posed.held_out == ("cam2",) and set(footage.names) == set(posed.footage.names)


@pytest.mark.parametrize(
    ("names", "said"),
    [(("take2_9", "take2_10", "take3_9"), "0 take2_9, 1 take2_10, 2 take3_9"), (("a1", "B2", "c"), "0 a1, 1 B2, 2 c")],
)
def test_cameras_without_numbers_of_their_own_have_their_place(
    names: tuple[str, ...], said: str, tmp_path: Path
) -> None:
    for number, name in enumerate(names):
        write_camera(tmp_path / f"{name}.mp4", number, 2)
    lines: list[str] = []
    footage = read(tmp_path, log=lines.append)
    assert (footage.names, numbers(footage), footage.held_out) == (names, (0, 1, 2), names[:1])
    assert lines == [f"cameras are numbered by their place in the order of names: {said}"]


def test_first_images_are_full_size_first_frames_in_use(filmed: Path, tmp_path: Path) -> None:
    footage = read(filmed, first_frame=2, drop_cameras=[1], cache=tmp_path / "cache")
    for number, image in zip(numbers(footage), footage.first_images().values(), strict=True):
        assert image.shape == (HEIGHT, WIDTH, 3) and image.dtype == np.uint8
        assert np.abs(inside(image).astype(int) - inside(picture(number, 2))).max() <= CODEC
    assert not (tmp_path / "cache").exists()  # nothing else was decoded


def test_to_scene_with_given_cameras(filmed: Path, tmp_path: Path) -> None:
    footage = read(filmed, cache=tmp_path)
    scene = footage.to_scene(cameras(footage), unit=2.0)
    assert (len(scene.train), len(scene.test), scene.unit) == (3 * FRAMES, FRAMES, 2.0)
    assert scene.train[0].name == "train/GX 03_0000"
    camera = scene.train[0].camera
    assert (camera.width, camera.fx, camera.fy, camera.cx, camera.cy) == (WIDTH / 2, 25.0, 25.5, 15.5, 12.5)
    low, high = scene.init_box
    assert all((low < view.camera.position).all() and (view.camera.position < high).all() for view in scene.train)


def test_undistortion_before_downscaling(filmed: Path, tmp_path: Path) -> None:
    footage = read(filmed, cache=tmp_path, downscale=1)
    known = cameras(footage)
    plain = footage.to_scene(known)
    none = footage.to_scene(known, {name: Undistortion.of(camera) for name, camera in known.items()})
    assert len(list(tmp_path.glob("video_*"))) == 1  # the same store
    undistorted = footage.to_scene(known, {"right": Undistortion.of(known["right"], -0.4)})
    same = {view.name: np.array_equal(view.image, other.image) for view, other in zip(plain.train, undistorted.train)}
    assert {name for name, equal in same.items() if not equal} == {f"train/right_{i:04d}" for i in range(FRAMES)}
    assert all(np.array_equal(view.image, other.image) for view, other in zip(plain.train, none.train))
    # The principal point is fixed; other pixels move.
    before, after = (np.asarray(scene.train[-1].image).astype(int) for scene in (plain, undistorted))
    assert np.abs(before[22:28, 28:34] - after[22:28, 28:34]).max() <= CODEC
    # x = -0.6 (column 1) was distorted to -0.6 (1 - 0.4 · 0.36) = -0.5136, column 5.3.
    assert np.abs(after[25, 1] - before[25, 5]).max() <= 2 * CODEC


def write_truth(folder: Path, frames: int) -> None:
    """Of each camera; what moves in frame i is pixel i, whose depth is i + 1."""
    (folder / "truth").mkdir()
    for name in NAMES:
        arrays = {}
        for frame in range(frames):
            moving = np.zeros((HEIGHT, WIDTH), bool)
            moving.flat[frame] = True
            arrays |= {f"moving_{frame:04d}": moving, f"depth_{frame:04d}": moving * (frame + 1.0)}
        np.savez(folder / "truth" / f"{Path(name).stem}.npz", **arrays)


def test_truth_is_of_undistorted_images_without_estimated_depth(filmed: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(filmed, tmp_path / "footage")
    write_truth(folder, FRAMES)
    footage = read(folder, cache=tmp_path / "cache", downscale=1, first_frame=2)
    known = cameras(footage)
    bent = {"right": Undistortion.of(known["right"], -0.1), "left": Undistortion.of(known["left"])}
    for estimated in (False, True):
        for view in footage.to_scene(known, bent, estimated=estimated).train:
            assert (view.truth is None) == view.name.startswith("train/right")
            if view.truth is not None:
                truth, frame = view.truth.read(), int(view.name[-4:])
                assert truth.moving is not None and truth.moving.argmax() == frame
                assert truth.depth is None if estimated else truth.depth.max() == frame + 1


def test_truth_of_unsynchronised_cameras_is_that_of_the_frames_shown(filmed: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(filmed, tmp_path / "footage")
    write_truth(folder, FRAMES)
    starts = (0.0, 1 / RATE, 0.0, 0.0)  # the second camera shows one frame less at each time
    footage = read(folder, cache=tmp_path / "cache", downscale=1, sync="given", offsets=starts)
    frames = []
    for view in footage.to_scene(cameras(footage)).train:
        assert view.truth is not None and (moving := view.truth.read().moving) is not None
        number = footage.names.index(view.name.split("/")[1].rpartition("_")[0])
        difference = np.abs(inside(np.asarray(view.image)).astype(int) - inside(picture(number, int(moving.argmax()))))
        assert difference.max() <= CODEC
        frames.append((number, int(moving.argmax())))
    assert len(frames) == 3 * (FRAMES - 1) and {(1, 0), (2, FRAMES - 1)} <= set(frames) and (2, 0) not in frames


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda known: known.pop("left"),
            r"left\.MKV: expected a pose for each camera, found none; "
            r"scene\.drop_cameras=\[2\] leaves camera 2 out",
        ),
        (
            lambda known: known.update(left=known["left"].resized(32, 24)),
            r"left\.MKV: expected a camera of 64 x 48 "
            r"pixels, found 32 x 24",
        ),
        (lambda known: known.update({name: replace(known["b.cam"], fx=70.0) for name in known}), "two places or more"),
    ],
)
def test_invalid_cameras_are_refused_before_decoding(filmed: Path, tmp_path: Path, change, message: str) -> None:
    footage = read(filmed, cache=tmp_path / "cache")
    known = cameras(footage)
    change(known)
    with pytest.raises(SceneError, match=message) as caught:
        footage.to_scene(known)
    assert "\n" not in str(caught.value) and not (tmp_path / "cache").exists()


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda f: shutil.rmtree(f), "folder of videos or images in order, found nothing there"),
        (lambda f: (shutil.rmtree(f), f.write_text("")), "folder of videos or images in order, found a file"),
        (
            lambda f: [path.unlink() for path in f.iterdir()],
            r"expected videos \(\.mp4, \.mov, \.mkv, \.avi, \.m4v, \.webm, .*\) or images in order, found no",
        ),
        (
            lambda f: shutil.copy(f / NAMES[1], f / "left.mp4"),
            r"left\.MKV: expected one video a camera, found several "
            "called left",
        ),
        (lambda f: (f / NAMES[3]).write_text("hello"), r"right\.avi: expected a video, .*scene\.drop_cameras=\[3\]"),
    ],
)
def test_invalid_footage_is_refused(filmed: Path, tmp_path: Path, damage, message: str) -> None:
    folder = shutil.copytree(filmed, tmp_path / "footage")
    damage(folder)
    with pytest.raises(SceneError, match=message) as caught:
        read(folder)
    assert "\n" not in str(caught.value)


def test_a_video_without_a_path_is_named() -> None:
    for reader in ("video", "auto"):
        with pytest.raises(SceneError, match="scene.path: expected the folder of the data"):
            open_source(SceneConfig(reader=reader))


def test_matroska_has_as_many_frames_as_packets_and_their_times(tmp_path: Path) -> None:
    """Headers say 30 frames a second and no number: 35 frames would fit the duration of 24, 20 a second."""
    times = np.arange(24) / 20
    for name in ("a", "b"):
        write_clip(tmp_path / f"{name}.mkv", [textured_plane(i) for i in range(24)], times.tolist())
    assert read(tmp_path, sync="none").count == 24
    footage = read(tmp_path, sync="given", offsets=[0, 0.2])
    for stream, start in zip(footage.streams, (0, 0.2)):
        assert isinstance(stream, FilmStream) and stream.film.count == 24
        np.testing.assert_allclose(stream.times, start - 0.2 + times[list(stream.indices)], atol=2e-3)
        assert len(list(stream.read(1))) == stream.count


@pytest.mark.parametrize("late", [0.0, 0.01, 0.04])
def test_frames_have_their_own_times_unless_these_are_rounding(tmp_path: Path, late: float) -> None:
    """20 frames a second, of one camera up to `late` seconds late in the middle; both start and end together."""
    even = np.arange(24) / 20
    varying = even + late * np.sin(np.linspace(0, np.pi, 24))
    for name, times in (("a", even), ("b", varying)):
        write_clip(tmp_path / f"{name}.mp4", [textured_plane(i) for i in range(24)], times.tolist())
    first, second = read(tmp_path, sync="given", offsets=[0, 0]).streams
    assert isinstance(second, FilmStream)
    np.testing.assert_allclose(first.times, even[list(first.ticks)], atol=1e-9)
    expected = varying[list(second.indices)]
    # Ticks of the file are 1/90000 s; less than a tenth of a frame is none.
    np.testing.assert_allclose(second.times, expected, atol=1e-4 if late == 0.04 else 5e-3)
    assert np.abs(np.array(second.times) - even[list(second.ticks)]).max() <= 0.5 / 20 + 1e-4
