"""The Plenoptic Video reader refuses every kind of invalid input in one line, before it decodes where possible."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from plenoptic_folder import FRAMES, RATE, pose_row, read, write_camera

from datasets.files.errors import SceneError


@pytest.fixture
def folder(video_folder: Path, tmp_path: Path) -> Path:
    return shutil.copytree(video_folder, tmp_path / "scene")


def poses(change: Callable[[np.ndarray], object]) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        table = np.load(folder / "poses_bounds.npy")
        changed = change(table)
        np.save(folder / "poses_bounds.npy", table if changed is None else changed)

    return damage


def setting(column: int, value: float, row: int = 1) -> Callable[[Path], None]:
    return poses(lambda table: table.__setitem__((row, column), value))


def cut(part: float) -> Callable[[Path], None]:
    """Truncates the video to the index, which comes first, and `part` of the frames."""

    def damage(folder: Path) -> None:
        path = folder / "cam01.mp4"
        content = path.read_bytes()
        begin = content.index(b"mdat")
        path.write_bytes(content[: begin + int(part * (len(content) - begin))])

    return damage


def film(*arguments: object, **options: int) -> Callable[[Path], None]:
    return lambda folder: write_camera(folder / "cam01.mp4", 1, *arguments, **options)


def small_films(folder: Path, width: int, height: int) -> None:
    for number in range(3):
        write_camera(folder / f"cam{number:02d}.mp4", number, width=width, height=height)
    np.save(folder / "poses_bounds.npy", np.stack([pose_row(number, (width, height)) for number in range(3)]))


DROP = r"scene\.drop_cameras=\[1\] leaves camera 1 out"
POSES = r"poses_bounds\.npy"
INVALID_INPUT: dict[str, tuple[Callable[[Path], object], dict, str]] = {
    "no videos": (lambda f: [path.unlink() for path in f.glob("*")], {}, "expected cam00.mp4 … and .* found neither"),
    "not a folder": (lambda f: (shutil.rmtree(f), f.write_text("")), {}, "in the layout of plenoptic, found a file"),
    "nothing": (lambda f: shutil.rmtree(f), {}, "expected a folder in the layout of plenoptic, found nothing there"),
    "not a video": (
        lambda f: (f / "cam01.mp4").write_text("hello"),
        {},
        rf"cam01\.mp4: expected a video, found a file that cannot be opened as one .*; {DROP}",
    ),
    "empty video": (lambda f: (f / "cam01.mp4").write_bytes(b""), {}, rf"cam01\.mp4: expected a video, found .*{DROP}"),
    "video without frames": (cut(0.05), {}, rf"cam01\.mp4: expected a video, found no frame .*{DROP}"),
    "truncated": (
        cut(0.4),
        {},
        rf"cam01\.mp4: expected frames at 6 times, 0.000 to 0.167 s, as the others, found [12], .*{DROP}",
    ),
    "other size": (
        film(width=80),
        {},
        rf"cam01\.mp4: expected 64 x 48 pixels as cam00\.mp4, found 80 x 48: "
        rf"unsynchronised; {DROP}",
    ),
    "other rate": (
        film(FRAMES, 25),
        {},
        rf"cam01\.mp4: expected 30 frames a second as cam00\.mp4, found 25: "
        rf"unsynchronised; {DROP}",
    ),
    "later start": (
        film(FRAMES, RATE, "-output_ts_offset", "0.14"),
        {},
        rf"cam01\.mp4: expected frames at 6 times, .* found \d, 6 intact frames from 0.1.. to 0.3.. s: .*{DROP}",
    ),
    "fewer frames": (film(FRAMES - 4), {}, rf"cam01\.mp4: expected frames at 6 times, .* found 2, .*{DROP}"),
    "fewer frames than another was dropped": (
        film(FRAMES - 4),
        {"drop_cameras": [2], "test_cameras": [1]},
        r"scene\.drop_cameras=\[1,2\] leaves camera 1 out",
    ),
    "first frame beyond the end": (
        lambda f: None,
        {"first_frame": FRAMES},
        "scene.first_frame: expected below the 6 frames of each camera, found 6",
    ),
    "too small": (lambda f: small_films(f, 16, 8), {}, r"cam00\.mp4: expected at least 16 pixels a side, found 16 x 8"),
    "no such test camera": (
        lambda f: None,
        {"test_cameras": [7]},
        "scene.test_cameras: expected cameras among 0, 1, 2, found 7",
    ),
    "no such camera to drop": (
        lambda f: None,
        {"drop_cameras": [13]},
        "scene.drop_cameras: expected cameras among 0, 1, 2, found 13",
    ),
    "test camera dropped": (
        lambda f: None,
        {"drop_cameras": [0]},
        "scene.drop_cameras: expected no camera of scene.test_cameras, found 0 in both",
    ),
    "nothing to train on": (
        lambda f: None,
        {"test_cameras": [0, 1], "drop_cameras": [2]},
        "one camera to train on, found 3 cameras, of which 2 held out and 1 dropped",
    ),
    "one camera twice": (
        lambda f: shutil.copy(f / "cam01.mp4", f / "cam1.mp4"),
        {},
        "expected one name a camera, found several with number 1",
    ),
    "one camera position": (setting(3, 2.0), {}, "two places or more .* found 12 at one place"),
    "no poses": (lambda f: (f / "poses_bounds.npy").unlink(), {}, rf"{POSES}: expected a file \(.*scene=video\)"),
    "poses not an array": (lambda f: (f / "poses_bounds.npy").write_text("hello"), {}, f"{POSES}: expected a numpy"),
    "poses empty": (lambda f: (f / "poses_bounds.npy").write_bytes(b""), {}, f"{POSES}: expected a numpy array"),
    "poses 16 wide": (poses(lambda t: t[:, :16]), {}, rf"{POSES}: expected .* one row of 17 .* float64 \(3, 16\)"),
    "poses of strings": (poses(lambda t: t.astype(str)), {}, rf"{POSES}: expected numbers"),
    "one pose too few": (poses(lambda t: t[:2]), {}, f"{POSES}: expected 3 poses, one a video in the folder, found 2"),
    "pose NaN": (setting(3, float("nan")), {}, rf"{POSES}: row 1 \(cam01\): expected finite numbers, found NaN or Inf"),
    "pose scaled": (setting(5, 1.2), {}, rf"{POSES}: row 1 \(cam01\): expected a rigid pose"),
    "pose mirrored": (setting(1, -1.0), {}, rf"{POSES}: row 1 .* a rigid pose .* det R -1"),
    "focal zero": (setting(14, 0.0), {}, rf"{POSES}: row 1 \(cam01\): expected .* focal length > 0, found 48, 64, 0"),
    "other shape": (setting(9, 100.0), {}, rf"{POSES}: row 1 .*expected the videos' 64 x 48 pixels .* found 100 x 48"),
    "near negative": (setting(15, -1.0), {}, rf"{POSES}: row 1 \(cam01\): expected .* found near -1, far 10"),
    "near beyond far": (setting(15, 11.0), {}, rf"{POSES}: row 1 \(cam01\): .* found near 11, far 10"),
}


@pytest.mark.parametrize("case", INVALID_INPUT)
def test_invalid_input_is_refused_in_one_line(folder: Path, case: str, capfd: pytest.CaptureFixture[str]) -> None:
    damage, options, message = INVALID_INPUT[case]
    damage(folder)
    with pytest.raises(SceneError, match=message) as caught:
        read(folder, **options)
    assert "\n" not in str(caught.value) and str(folder) in str(caught.value)
    assert capfd.readouterr() == ("", "")  # no output of the decoder
    assert not (folder.parent / "cache").exists()


def test_dropped_camera_may_be_invalid(folder: Path) -> None:
    (folder / "cam01.mp4").write_text("hello")
    setting(0, float("nan"))(folder)
    write_camera(folder / "cam03.mp4", 3)
    table = np.load(folder / "poses_bounds.npy")
    np.save(folder / "poses_bounds.npy", np.vstack([table, pose_row(3)]))
    scene = read(folder, drop_cameras=[1])
    assert {view.name[:11] for view in scene.train} == {"train/cam02", "train/cam03"}
    assert scene.train[-1].camera.position[0] == pytest.approx(3)
