"""Cameras on one clock by their time stamps: dropped, late, damaged and missing frames; a frozen camera; chapters."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from clips import textured_plane, write_clip
from plenoptic_folder import HEIGHT, WIDTH, opened, pose_row

from datasets.files.errors import SceneError
from datasets.scene import Scene

RATE, FRAMES = 30.0, 30
STEP = 6  # columns that the stripe moves a frame: of WIDTH, 10 places
PLACES = WIDTH // STEP


def clock(frame: int) -> np.ndarray:
    """(HEIGHT, WIDTH, 3): textured, with a white stripe in the upper half that shows frame % 10, in the lower // 10."""
    image = textured_plane(0, (WIDTH, HEIGHT)) // 4
    for row, digit in ((slice(0, HEIGHT // 2), frame % PLACES), (slice(HEIGHT // 2, HEIGHT), frame // PLACES)):
        image[row, digit * STEP : (digit + 1) * STEP] = 255
    return image


def shown(image: np.ndarray) -> int:
    """The frame that `clock` painted."""
    bright = image[..., 1].astype(float)[:, : PLACES * STEP].reshape(2, HEIGHT // 2, PLACES, STEP).mean(axis=(1, 3))
    return int(bright[0].argmax() + PLACES * bright[1].argmax())


def write(path: Path, frames: Sequence[int], start: float = 0.0, **options: str) -> None:
    """The frames of a clock of RATE at their times."""
    write_clip(path, [clock(i) for i in frames], [start + i / RATE for i in frames], options=options)


def listed(numbers: set[int]) -> str:
    """The first six."""
    return ", ".join(map(str, sorted(numbers)[:6])) + (", …" if len(numbers) > 6 else "")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Four cameras of FRAMES frames."""
    folder = tmp_path / "scene"
    folder.mkdir()
    write(folder / "cam00.mp4", range(FRAMES), g="6", bf="2")
    for number in (1, 2, 3):
        shutil.copy(folder / "cam00.mp4", folder / f"cam{number:02d}.mp4")
    np.save(folder / "poses_bounds.npy", np.stack([pose_row(number) for number in range(4)]))
    return folder


def read(folder: Path, **options: object) -> tuple[Scene, list[str]]:
    """The scene, and what was said of its cameras."""
    lines: list[str] = []
    scene = opened(folder, log=lines.append, **options).scene()
    return scene, [line for line in lines if not line.startswith("decoded")]


def check(scene: Scene, left_out: dict[str, set[int]], first: int = 0, frames: int = FRAMES) -> None:
    """Every view shows the moment that its time and its name say, and no other view is missing."""
    found: dict[str, set[int]] = {}
    for view in scene.train + scene.test:
        number = shown(np.asarray(view.image))
        assert view.time == pytest.approx((number - first) / RATE, abs=1e-9)
        assert view.name.endswith(f"_{number:04d}")
        found.setdefault(view.filmed_by, set()).add(number)
    wanted = set(range(first, first + frames))
    assert found == {f"cam{number:02d}": wanted - left_out.get(f"cam{number:02d}", set()) for number in range(4)}


def test_a_dropped_frame_is_left_out_and_those_after_it_keep_their_times(folder: Path) -> None:
    write(folder / "cam02.mp4", [i for i in range(FRAMES) if i != 9])
    scene, said = read(folder)
    check(scene, {"cam02": {9}})
    assert said == ["cam02.mp4: no intact frame at 1 of 30 times, which are left out: 9"]
    scene, said = read(folder, first_frame=10, frames=15)
    check(scene, {}, 10, 15)
    assert said == []


def test_cameras_that_start_late_or_end_early_lack_those_frames(folder: Path) -> None:
    write(folder / "cam01.mp4", range(3, FRAMES))
    write(folder / "cam03.mp4", range(FRAMES - 2))
    scene, said = read(folder)
    check(scene, {"cam01": {0, 1, 2}, "cam03": {28, 29}})
    assert [line.split(":")[0] for line in said] == ["cam01.mp4", "cam03.mp4"]


def test_a_damaged_stretch_is_left_out_of_one_camera(folder: Path) -> None:
    path = folder / "cam01.mp4"
    content = bytearray(path.read_bytes())
    begin = content.index(b"mdat")
    content[begin + 3000 : begin + 3400] = bytes(400)
    path.write_bytes(content)
    scene, said = read(folder)
    left = set(range(FRAMES)) - {int(view.name[-4:]) for view in scene.train if view.filmed_by == "cam01"}
    assert 1 <= len(left) <= 12 and max(left) - min(left) < 12
    check(scene, {"cam01": left})
    assert len(said) == 1 and "frames are damaged, up to the next key frame, and left out" in said[0]
    assert said[0].endswith(f"no intact frame at {len(left)} of 30 times, which are left out: {listed(left)}")


def test_stamps_of_a_varying_rate_align_too(folder: Path) -> None:
    """Of each frame the time is right; two in a tick's half step or none leave out one."""
    times = (np.arange(FRAMES) + np.random.default_rng(0).uniform(-0.3, 0.3, FRAMES)) / RATE
    times -= times[0]
    write_clip(folder / "cam02.mp4", [clock(i) for i in range(FRAMES)], times.tolist())
    scene, _ = read(folder)
    views = [view for view in scene.train if view.filmed_by == "cam02"]
    assert len(views) > 25
    for view in views:
        # A time that is less than a tenth of a frame off its tick is the tick's.
        assert view.time == pytest.approx(times[shown(np.asarray(view.image))], abs=0.1 / RATE)


def test_a_camera_whose_frames_are_all_one_is_refused(folder: Path) -> None:
    times = [i / RATE for i in range(FRAMES)]
    write_clip(folder / "cam02.mp4", [clock(3)] * FRAMES, times, codec="png", pixels="rgb24")  # lossless
    with pytest.raises(SceneError, match=r"cam02\.mp4: expected frames that differ, found 30 that are equal"):
        read(folder)


def test_a_codecs_padding_is_cut_off_and_no_loss_of_synchrony(folder: Path) -> None:
    """One camera's file shows the lines that its codec added below."""
    taller = [np.concatenate([clock(i), clock(i)[-8:]]) for i in range(FRAMES)]
    write_clip(folder / "cam01.mp4", taller, [i / RATE for i in range(FRAMES)])
    scene, _ = read(folder)
    padded = [np.asarray(view.image) for view in scene.train if view.filmed_by == "cam01"]
    assert [shown(image) for image in padded] == list(range(FRAMES)) and padded[0].shape[:2] == (HEIGHT, WIDTH)


def test_chapters_of_one_take_are_named(tmp_path: Path) -> None:
    for name in ("GX010042", "GX020042"):
        write(tmp_path / f"{name}.MP4", range(4))
    with pytest.raises(SceneError, match=r"GX020042\.MP4: .*a chapter of the take that GX010042\.MP4 is of too: join"):
        opened(tmp_path, "video")
