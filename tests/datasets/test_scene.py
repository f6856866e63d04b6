"""validate_scene, camera_extent, and the properties of Scene."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tiny_film import tiny_film, unsynchronised_film

from datasets.files.errors import SceneError
from datasets.scene import Scene, View, camera_extent, capture_of, validate_scene
from rasterizer.camera import Camera


def camera_at(x: float, y: float, z: float, width: int = 6, height: int = 4) -> Camera:
    world_to_cam = np.eye(4)
    world_to_cam[:3, 3] = -x, -y, -z
    return Camera(width, height, 5.0, 5.0, width / 2, height / 2, world_to_cam)


def view(name: str, x: float = 0.0, time: float = 0.0, width: int = 6) -> View:
    return View(camera_at(x, 0.0, 4.0, width), time, np.zeros((4, width, 3), dtype=np.uint8), name)


def scene(**changes: object) -> Scene:
    fields = dict(
        name="toy",
        train=(view("train/a", -1.0, 0.0), view("train/b", 1.0, 1.0)),
        test=(view("test/a", 0.5, 0.5),),
        duration=1.0,
        time_start=0.0,
        background=(0.0, 0.0, 0.0),
        extent=1.1,
        init_box=(-1.2, 1.2),
        source=Path("toy"),
        capture="monocular",
    )
    return Scene(**{**fields, **changes})


def test_valid_scene_is_returned_unchanged() -> None:
    valid = scene()
    assert validate_scene(valid) is valid
    assert valid.time_end == 1.0


def test_capture_of_photographs_by_their_times() -> None:
    two = (view("a", -1.0, 0.3), view("b", 1.0, 0.3))
    assert capture_of(two, (view("c", 0.0, 0.3),), filmed=False) == "static"
    assert capture_of(two, (view("c", 0.0, 0.4),), filmed=True) == "multi_view"  # both at one time
    apart = (view("a", -1.0, 0.3), view("b", 1.0, 0.4), view("c", 0.0, 0.4))  # less than two at a time in the mean
    assert capture_of(apart, (), filmed=False) == "monocular" and capture_of(apart, (), filmed=True) == "clip"


def test_frame_spacing_is_that_of_the_training_times() -> None:
    times = (0.2, 0.3, 0.3, 0.6)
    views = tuple(view(str(i), float(i), time) for i, time in enumerate(times))
    assert scene(train=views).frame_spacing == pytest.approx(0.2)
    assert scene(train=views[:1], duration=0.5).frame_spacing == 0.5


def test_unsynchronised_cameras_have_the_frame_spacing_of_one() -> None:
    film = unsynchronised_film()
    assert len(film.train) == len({view.time for view in film.train}) == 4 * 30  # every view has a time of its own
    assert capture_of(film.train, film.test, filmed=True) == "multi_view" and film.frame_count == 30
    assert film.frame_spacing == pytest.approx(1 / 30, rel=1e-12)
    one = replace(film, train=tuple(replace(view, filmed_by="") for view in film.train))  # the same by one camera
    assert capture_of(one.train, one.test, filmed=True) == "clip" and one.frame_count == 120
    assert not replace(one, capture="clip").several_cameras and film.several_cameras
    assert replace(film, capture="drive").several_cameras and not replace(one, capture="drive").several_cameras


def test_spacing_of_synchronised_cameras_is_that_of_all_times_to_the_bit() -> None:
    film = tiny_film(frames=7)
    times = sorted({view.time for view in film.train})
    assert film.frame_spacing == (times[-1] - times[0]) / 6 and film.frame_count == 7 and film.several_cameras


def test_extent_is_that_of_3dgs() -> None:
    cameras = [camera_at(0, 0, 0), camera_at(3, 0, 0), camera_at(0, 3, 0)]  # centre (1, 1, 0), largest distance √5
    assert camera_extent(cameras) == pytest.approx(1.1 * 5**0.5, rel=1e-12)


def test_extent_does_not_depend_on_the_origin() -> None:
    cameras = [camera_at(x + 100, 7, -3) for x in (0, 1, 5)]
    assert camera_extent(cameras) == pytest.approx(1.1 * 3.0, rel=1e-12)  # centre 2, farthest 5


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"train": ()}, "at least one train view, found none"),
        ({"test": ()}, "at least one test view, found none"),
        ({"duration": 0.0}, "duration > 0, found start 0.0, duration 0.0"),
        ({"duration": float("nan")}, "duration nan"),
        ({"background": (0.0, 2.0, 0.0)}, r"three values in \[0, 1\], found \(0.0, 2.0, 0.0\)"),
        ({"init_box": (1.0, -1.0)}, r"low < high, found \(1.0, -1.0\)"),
        ({"extent": 0.0}, "two places or more .* found 2 at one place"),
        ({"test": (view("test/a", time=1.5),)}, r"test/a: expected a time in \[0, 1\], found 1.5"),
        ({"test": (view("test/a", time=float("nan")),)}, "test/a: expected a time .* found nan"),
        ({"test": (view("test/a", width=8),)}, "6 x 4 pixels as train/a, found 8 x 4"),
        ({"test": (view("train/a"),)}, "each view's name once, found train/a in the training and the test split"),
        (
            {"test": (replace(view("test/a"), image=np.zeros((4, 5, 3), dtype=np.uint8)),)},
            r"test/a: expected an image of uint8 \(4, 6, 3\)",
        ),
        ({"test": (replace(view("test/a"), image=np.zeros((4, 6, 3), dtype=np.float32)),)}, "found float32"),
    ],
)
def test_invalid_scene_is_refused(changes: dict, message: str) -> None:
    with pytest.raises(SceneError, match=message) as caught:
        validate_scene(scene(**changes))
    assert "\n" not in str(caught.value)


def test_error_is_one_line() -> None:
    assert str(SceneError("a.json", "one line", "two\n  lines")) == "a.json: expected one line, found two lines"


def test_times_are_shown_in_seconds_where_these_are_known() -> None:
    """Photographs have none. A clip of 3 frames at 4 a second, one held out between them, lasts 0.75 s. 30 frames of a
    film are one unit. A log says it."""
    photographs = scene(time_start=2.0)
    assert (photographs.clock, photographs.played_seconds, photographs.seconds_at(2.5)) == (1.0, None, 0.5)
    three = (view("a", -1.0, 0.0), view("b", 1.0, 0.3), view("c", 0.0, 1.0))
    clip = scene(train=three, capture="clip", playback_rate=4.0)
    assert (clip.played_seconds, clip.seconds_at(0.3), clip.time_at(0.25)) == pytest.approx((0.75, 0.225, 1 / 3))
    film = scene(capture="multi_view", frame_rate=30.0, playback_rate=25.0)
    assert film.played_seconds == pytest.approx(1.2)
    drive = scene(capture="drive", seconds_per_unit=5.0)
    assert (drive.played_seconds, drive.time_at(2.5)) == (5.0, 0.5)
