"""What names of files and folders say of cameras and times, in nerfstudio's layout."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from layout_folders import write_nerfstudio
from layout_scenes import read
from scipy.spatial.transform import Rotation

from datasets.files.errors import SceneError
from datasets.files.natural_order import about_even, last_number, starts_again
from datasets.photographs.file_names import by_name
from datasets.photographs.photograph import PosedFile
from datasets.scene import Scene
from rasterizer.camera import Camera

CAMERAS, TIMES = 4, 8


def named(
    root: Path,
    name: str,
    still: bool,
    times: bool = False,
    offset: float = 0.0,
    noise: float = 0.0,
    turning: bool = False,
) -> Scene:
    """CAMERAS × TIMES images with names of {camera} and {time}. still: each camera has one pose, else every image.

    offset: how far an estimated pose is off, in x; ± in turn. noise: standard deviation of the positions. turning: all
    cameras turn and move together, by a tenth of a radian and unit a moment.
    """
    rng = np.random.default_rng(0)
    write_nerfstudio(root, CAMERAS * TIMES)
    file = root / "transforms.json"
    content = json.loads(file.read_text())
    poses = [frame["transform_matrix"] for frame in content["frames"]]
    for index, frame in enumerate(content["frames"]):
        camera, time = index % CAMERAS, index // CAMERAS
        before, frame["file_path"] = (
            frame["file_path"],
            f"images/{name.format(camera=camera, time=time, letter='abcdefgh'[time])}.png",
        )
        pose = poses[camera if still else index]
        matrix = np.array(pose)
        matrix[:3, 3] += [offset * (-1) ** time, 0, 0] + noise * rng.normal(size=3)
        if turning:
            rig = np.eye(4)
            rig[:3, :3], rig[:3, 3] = Rotation.from_euler("zx", [0.1 * time, 0.05 * time]).as_matrix(), 0.1 * time
            matrix = rig @ matrix
        frame["transform_matrix"] = matrix.tolist()
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


@pytest.mark.parametrize("offset", [0.0, 1e-3])
@pytest.mark.parametrize(
    "name, camera",
    [
        ("rig_undist_{time:05d}_{camera:02d}", "00"),
        ("frame_{time:04d}_cam{camera}", "cam0"),
        ("t{time:03d}c{camera}", "c0"),
        ("{time:03d}/{camera:02d}", "00"),
        ("image_{camera}/c{camera}_{time:04d}", "image_0"),
        ("2024_{camera}_{time}", "0"),
    ],
)
def test_the_poses_say_which_number_is_the_camera(tmp_path: Path, name: str, camera: str, offset: float) -> None:
    """Numbers in any order; with poses that are each estimated by itself, too, unless the folders say otherwise."""
    if offset and "/" in name and camera == "00":
        with pytest.raises(SceneError, match=r"that fit 4 cameras \(00 … 03\) × 8 times and 8 cameras"):
            named(tmp_path, name, still=True, noise=offset)
        return
    scene = named(tmp_path, name, still=True, noise=offset)
    assert scene.test_split == f"camera 0 ({camera})" and len(scene.test) == TIMES
    assert {view.time for view in scene.train} == set(range(TIMES))


@pytest.mark.parametrize("name", ["{time:04d}_{camera}", "{camera}_{time:04d}"])
def test_a_rig_that_moves_keeps_its_cameras_apart(tmp_path: Path, name: str) -> None:
    scene = named(tmp_path, name, still=True, turning=True)
    assert scene.test_split == "camera 0 (0)" and {view.time for view in scene.train} == set(range(TIMES))


def test_names_that_poses_do_not_decide_are_refused(tmp_path: Path) -> None:
    """Each image from a place of its own, and numbers that no word explains."""
    with pytest.raises(SceneError, match=r"fit 4 cameras \(0 … 3\) × 8 times and 8 cameras"):
        named(tmp_path, "{time:04d}_{camera}", still=False)


@pytest.mark.parametrize(
    "name, held_out",
    [
        ("GX{camera:02d}{time:04d}", "camera 0 (GX00)"),
        ("moment_{letter}/left_{camera}", "camera 0 (left_0)"),
        ("right_{camera}_{time:04d}", "camera 0 (0)"),  # the t before the number is no word
    ],
)
def test_numbers_without_a_gap_and_moments_by_words(tmp_path: Path, name: str, held_out: str) -> None:
    scene = named(tmp_path, name, still=True)
    assert scene.test_split == held_out and len(scene.test) == TIMES


def test_a_car_with_two_cameras_is_not_a_hundred_cameras_that_see_two_times() -> None:
    """Its cameras are a hundredth of its way apart; what moves them is no noise."""
    photographs = []
    for time in range(40):
        turn = Rotation.from_euler("z", 0.02 * time).as_matrix()
        for camera in range(2):
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = turn, turn @ [0.0, 0.5 * camera, 0.0] + [30 * np.sin(0.05 * time), time, 0.0]
            file = Path(f"/x/image_{camera + 2}/{time:06d}.png")
            photographs.append(PosedFile(file.stem, file, Camera(8, 8, 8, 8, 4, 4, np.linalg.inv(pose))))
    lines: list[str] = []
    assert [p.group for p in by_name(Path("/x"), photographs, lines.append)] == [0, 1] * 40
    assert "2 cameras (image_2 … image_3) × 40 times" in lines[0]


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


def test_fractions_of_a_second_are_no_times(tmp_path: Path) -> None:
    """A phone's names: second and hundredths. In the order of the names, which is that of time."""
    write_nerfstudio(tmp_path)
    file = tmp_path / "transforms.json"
    content = json.loads(file.read_text())
    names = [f"images/PXL_20241128_1015{i:02d}_{37 * i % 100:02d}.png" for i in range(12)]
    for frame, name in zip(content["frames"], names):
        (tmp_path / frame["file_path"]).rename(tmp_path / name)
        frame["file_path"] = name
    file.write_text(json.dumps(content))
    scene, _ = read(tmp_path)
    in_time = sorted((*scene.train, *scene.test), key=lambda view: view.time)
    assert [view.name.split("/")[1] for view in in_time] == [Path(name).stem for name in names]


@pytest.mark.parametrize(
    "stems, expected",
    [
        (["a_1_90", "a_2_10"], True),
        (["a_1_10", "a_2_90"], False),
        (["a_1_10", "b_2_9"], False),  # words
        (["20241128_2", "20241128_10"], False),
        (["t_0.5", "t_0.25", "t_1.1"], False),  # decimals
        (["1305031102.175304", "1305031103.075304"], False),
        (["first", "second"], False),
    ],
)
def test_last_numbers_that_start_again(stems: list[str], expected: bool) -> None:
    assert starts_again(stems) == expected
