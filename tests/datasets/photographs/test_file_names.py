"""What names of files and folders say of cameras and times, in nerfstudio's layout."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from layout_folders import write_nerfstudio
from layout_scenes import read

from datasets.files.natural_order import about_even, last_number
from datasets.scene import Scene

CAMERAS, TIMES = 4, 8


def named(root: Path, name: str, still: bool, times: bool = False, offset: float = 0.0) -> Scene:
    """CAMERAS × TIMES images with names of {camera} and {time}. still: each camera has one pose, else every image.

    offset: how far an estimated pose is off, in x; ± in turn.
    """
    write_nerfstudio(root, CAMERAS * TIMES)
    file = root / "transforms.json"
    content = json.loads(file.read_text())
    poses = [frame["transform_matrix"] for frame in content["frames"]]
    for index, frame in enumerate(content["frames"]):
        camera, time = index % CAMERAS, index // CAMERAS
        before, frame["file_path"] = frame["file_path"], f"images/{name.format(camera=camera, time=time)}.png"
        pose = poses[camera if still else index]
        frame["transform_matrix"] = [[*pose[0][:3], pose[0][3] + offset * (-1) ** time], *pose[1:]]
        if times:
            frame["time"] = 10.0 + time / 2
        (root / frame["file_path"]).parent.mkdir(parents=True, exist_ok=True)
        (root / before).rename(root / frame["file_path"])
    file.write_text(json.dumps(content))
    return read(root)[0]


@pytest.mark.parametrize("times", [False, True])
@pytest.mark.parametrize(
    "name", ["cam{camera}/{time:03d}", "cam{camera}_{time:03d}", "t{time:03d}/cam{camera}", "{time:03d}_cam{camera}"]
)
def test_cameras_that_stand_still(tmp_path: Path, name: str, times: bool) -> None:
    """Whether the camera is the folder or the file, the beginning of the name or its end."""
    scene = named(tmp_path, name, still=True, times=times)
    assert scene.capture == "multi_view" and scene.test_split == "camera 0 (cam0)"
    assert len(scene.test) == TIMES and len(scene.train) == (CAMERAS - 1) * TIMES
    assert sorted({view.time for view in scene.train}) == [10 + t / 2 if times else t for t in range(TIMES)]


@pytest.mark.parametrize("name", ["cam{camera}/{time:03d}", "cam{camera}_{time:03d}"])
def test_cameras_that_move_or_have_estimated_poses(tmp_path: Path, name: str) -> None:
    """Their numbers coincide, so that the frames of a number are of one moment."""
    for folder, arguments in (("moving", {"still": False}), ("estimated", {"still": True, "offset": 1e-3})):
        scene = named(tmp_path / folder, name, **arguments)
        assert {view.time for view in scene.train} == set(range(TIMES)) and scene.capture == "multi_view"
        assert scene.test_split == "camera 0 (cam0)"


def test_two_takes_of_one_camera_are_one_clip(tmp_path: Path) -> None:
    """Their numbers do not coincide."""
    names = [f"{'ab'[i >= 16]}_{i:02d}" for i in range(32)]
    write_nerfstudio(tmp_path, 32)
    file = tmp_path / "transforms.json"
    content = json.loads(file.read_text())
    for frame, name in zip(content["frames"], names):
        (tmp_path / frame["file_path"]).rename(tmp_path / f"images/{name}.png")
        frame["file_path"] = f"images/{name}.png"
    file.write_text(json.dumps(content))
    assert read(tmp_path)[0].capture == "clip"


@pytest.mark.parametrize("first", [5000, 846112073799])
def test_numbers_with_gaps_that_are_most_of_the_span_are_no_times(tmp_path: Path, first: int) -> None:
    """A camera that counts from 0, and one whose numbers begin elsewhere: the images of both are in order of time."""
    write_nerfstudio(tmp_path, 24)
    file = tmp_path / "transforms.json"
    content = json.loads(file.read_text())
    for index, frame in enumerate(content["frames"]):
        camera, number = divmod(index, 12)
        name = f"images/{'ab'[camera]}/{number + camera * first:04d}.png"
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / frame["file_path"]).rename(tmp_path / name)
        frame["file_path"] = name
    file.write_text(json.dumps(content))
    scene, lines = read(tmp_path)
    assert {view.time for view in (*scene.train, *scene.test)} == set(range(12))
    assert any("evenly spaced, in the order of the names of each camera" in line for line in lines)


@pytest.mark.parametrize(
    "stem, number",
    [
        ("frame_012", 12),
        ("12", 12),
        ("IMG_20230512_101559", 101559),
        ("shot-7_left", 7),
        ("1305031102.175304", 1305031102.175304),
        ("t_0.25", 0.25),
        ("1678901234_133000000", 1678901234.133),
        ("left", None),
    ],
)
def test_the_number_of_a_name(stem: str, number: float | None) -> None:
    assert last_number(stem) == number


@pytest.mark.parametrize(
    "numbers, expected",
    [
        ([3, 1, 2], True),
        ([0, 1, 2, 3, 7, 8], True),  # frames are missing
        ([0, 10, 20, 35], True),
        ([0, 1, 2, 1000], False),
        ([*range(50), *range(1000, 1050)], True),  # two halves of a long film
        ([0, 1, None], False),
        ([5, 5, 5], False),
        ([1], False),
        ([0, 1, float("inf")], False),
    ],
)
def test_which_numbers_may_be_times(numbers: list[float | None], expected: bool) -> None:
    assert about_even(numbers) is expected
