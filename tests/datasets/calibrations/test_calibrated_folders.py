"""Videos and images with a calibration beside them: names, direction of the poses, lens, principal point."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from plenoptic_folder import HEIGHT, WIDTH, picture, write_camera

from datasets.calibrations.named import matched
from datasets.calibrations.readings import READINGS, Y_UP, Reading, checked
from datasets.calibrations.rig import Rig
from datasets.cameras.lens import FisheyeLens
from datasets.files.errors import SceneError
from datasets.settings import SceneConfig
from datasets.source import Source, open_source
from datasets.synthetic.camera_path import look_at_origin
from datasets.urban.projection import project
from rasterizer.camera import Camera

NAMES = ("back", "side", "top")
PLACES = ((0.0, -4.0, 1.0), (4.0, 0.5, 0.5), (-1.0, 2.0, 4.0))


def cameras() -> dict[str, Camera]:
    poses = {name: look_at_origin(np.array(place)) for name, place in zip(NAMES, PLACES)}
    return {name: Camera.from_blender(WIDTH, HEIGHT, 50.0, pose) for name, pose in poses.items()}


def toml(poses: dict[str, np.ndarray], extra: str = "") -> str:
    return "".join(
        f'[{name}]\nname = "{name}"\nsize = [{WIDTH}, {HEIGHT}]\nmatrix = [[50, 0, 30], [0, 51, 20], [0, 0, 1]]\n'
        f"rotation = {pose[:3, :3].tolist()}\ntranslation = {pose[:3, 3].tolist()}\n{extra}\n"
        for name, pose in poses.items()
    )


def opened(folder: Path, calibration: str, **settings: object) -> tuple[Source, list[str]]:
    (folder / "rig.toml").write_text(calibration)
    lines: list[str] = []
    cfg = SceneConfig(
        name="rig", reader="video", path=str(folder), calibration=str(folder / "rig.toml"), sync="auto", downscale=1,
        cache=str(folder / "cache"), **settings,
    )  # fmt: skip
    return open_source(cfg, threads=1, log=lines.append), lines


def stated() -> dict[str, np.ndarray]:
    return {name: camera.world_to_cam for name, camera in cameras().items()}


def test_videos_in_folders_keep_principal_point_and_lens(tmp_path: Path) -> None:
    for number, name in enumerate(NAMES):
        (tmp_path / name).mkdir()
        write_camera(tmp_path / name / f"trial_{name}.mp4", number)
    source, lines = opened(tmp_path, toml(stated(), "distortions = [-0.1, 0, 0, 0]"))
    scene = source.scene()
    assert {view.filmed_by for view in scene.test} == {"back"}
    camera = scene.train[0].camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (50, 51, 30.5, 20.5)
    np.testing.assert_allclose(camera.world_to_cam, cameras()["side"].world_to_cam, atol=1e-12)
    distorted = opened(tmp_path, toml(stated()))[0].photographs()[0].image
    matrix, bent = np.array([[50.0, 0, 30], [0, 51, 20], [0, 0, 1]]), np.array([-0.1, 0, 0, 0])
    undistorted = cv2.undistort(distorted, matrix, bent)
    inside = undistorted.min(axis=2) > 0  # black beyond the lens's image
    np.testing.assert_array_equal(source.photographs()[0].image[inside], undistorted[inside])
    assert (undistorted != distorted).any()
    assert "TOML: 3 cameras, world-to-camera; 3 see the place where their axes meet" in lines


def test_fisheye_lenses_without_coefficients_are_undistorted(tmp_path: Path) -> None:
    for number, name in enumerate(NAMES):
        write_camera(tmp_path / f"{name}.mp4", number)
    source, _ = opened(tmp_path, toml(stated(), "fisheye = true"))
    lens = source.undistortion["top"]  # type: ignore[attr-defined]
    assert isinstance(lens, FisheyeLens)
    plain, _ = opened(tmp_path, toml(stated()))
    assert (source.photographs()[0].image != plain.photographs()[0].image).any()


@pytest.mark.parametrize("frames", [1, 3])
def test_images_one_a_camera_or_in_folders(tmp_path: Path, frames: int) -> None:
    for number, name in enumerate(NAMES):
        for frame in range(frames):
            file = tmp_path / (f"{name}.png" if frames == 1 else f"{name}/{frame:04d}.png")
            file.parent.mkdir(exist_ok=True)
            Image.fromarray(picture(number, frame)).save(file)
    source, _ = opened(tmp_path, toml(stated()))
    scene = source.scene()
    assert scene.capture == ("static" if frames == 1 else "multi_view")
    assert len(scene.train) == 2 * frames and scene.train[0].camera.cx == 30.5
    np.testing.assert_array_equal(np.asarray(scene.test[0].image), picture(0, 0))


def test_a_calibration_of_larger_images_is_scaled(tmp_path: Path) -> None:
    for number, name in enumerate(NAMES):
        write_camera(tmp_path / f"{name}.mp4", number)
    doubled = toml(stated()).replace(f"[{WIDTH}, {HEIGHT}]", f"[{2 * WIDTH}, {2 * HEIGHT}]")
    source, _ = opened(tmp_path, doubled)
    assert source.scene().train[0].camera.fx == 25
    with pytest.raises(SceneError, match=f"{WIDTH} x {HEIGHT} pixels as"):
        opened(tmp_path, toml(stated()).replace(f"[{WIDTH}, {HEIGHT}]", "[100, 100]"))


def seen_path() -> dict[str, np.ndarray]:
    """Where the cameras see a point that moves; at these sizes small images are the images."""
    turn = np.linspace(0, 2 * np.pi, 12)
    path = np.stack([np.cos(turn), np.sin(turn), 0.3 * np.sin(3 * turn)], axis=1)
    return {name: np.stack(project(path, camera)[:2], axis=1) for name, camera in cameras().items()}


def written(reading: Reading) -> dict[str, Camera]:
    """Cameras in a file whose poses only `reading` reads right."""
    inverse = {name: np.linalg.inv(pose) for name, pose in stated().items()}
    poses = {
        READINGS[0]: stated(), READINGS[1]: inverse, READINGS[2]: {n: Y_UP @ p for n, p in stated().items()},
        READINGS[3]: {n: np.linalg.inv(Y_UP @ p) for n, p in stated().items()},
    }[reading]  # fmt: skip
    return {name: replace(camera, world_to_cam=poses[name]) for name, camera in cameras().items()}


@pytest.mark.parametrize("reading", READINGS)
def test_a_format_without_direction_takes_the_reading_by_which_all_see_one_thing(reading: Reading) -> None:
    lines: list[str] = []
    rig = Rig("OpenCV", (), says_direction=False)
    found = checked(rig, written(reading), "rig.yaml", lines.append, moving=seen_path)
    np.testing.assert_allclose(found["top"].world_to_cam, cameras()["top"].world_to_cam, atol=1e-12)
    assert reading.name in lines[0]


@pytest.mark.parametrize("reading", READINGS[1:])
def test_a_format_with_a_direction_refuses_another(reading: Reading) -> None:
    with pytest.raises(SceneError, match=rf"as {reading.name} they do: invert or turn the poses in the file"):
        checked(Rig("TOML", ()), written(reading), "rig.toml", print, moving=seen_path)


def test_where_axes_meet_both_ways_and_nothing_moves_the_file_must_say() -> None:
    """Cameras that look at the origin from equal distances are, read the other way, at nearly one place."""
    with pytest.raises(SceneError, match=r"world-to-camera: in those of 3 of 3; .* keys world_to_cam or cam_to_world"):
        checked(Rig("OpenCV", (), says_direction=False), cameras(), "rig.yaml", print)


def test_axes_that_meet_in_no_reading_are_refused() -> None:
    poses = (
        [[0, 1, 0, -3], [0, 0, -1, 7], [-1, 0, 0, -3], [0, 0, 0, 1]],
        [[0, -1, 0, 4], [0, 0, -1, 5], [1, 0, 0, -1], [0, 0, 0, 1]],
        [[0, 0, -1, -9], [1, 0, 0, 3], [0, -1, 0, 4], [0, 0, 0, 1]],
    )
    apart = {
        name: replace(camera, world_to_cam=np.array(pose)) for (name, camera), pose in zip(cameras().items(), poses)
    }
    with pytest.raises(SceneError, match=r"camera: in those of 0 of 3; read camera-to-world: in those of 0 of 3$"):
        checked(Rig("OpenCV", (), says_direction=False), apart, "rig.yaml", print)


def test_two_cameras_at_one_place_are_refused() -> None:
    twins = cameras() | {"side": cameras()["back"]}
    with pytest.raises(SceneError, match="back and side at the same"):
        checked(Rig("TOML", ()), twins, "rig.toml", print)


def test_names_that_occur_in_file_names() -> None:
    words = {"minimal_back": "back/minimal_back", "calib-camTOP": "calib-cam-TOP", "cam_01": "cam_01"}
    lines: list[str] = []
    found = matched(["back", "top", "1", "front"], words, "rig.toml", lines.append)
    assert found == {"minimal_back": "back", "calib-camTOP": "top", "cam_01": "1"}
    assert "left out: front" in lines[0]


@pytest.mark.parametrize(
    ("names", "files", "complaint"),
    [
        (["back"], {"left": "left"}, "name of one camera of rig.toml: back, found none of them"),
        (["a", "b"], {"a_b": "a_b"}, "found a, b"),
        (["a"], {"a_1": "a_1", "a_2": "a_2"}, "a, which is a_1 too"),
    ],
)
def test_names_that_do_not_match(names: list[str], files: dict[str, str], complaint: str) -> None:
    with pytest.raises(SceneError, match=complaint):
        matched(names, files, "rig.toml", print)


def test_other_layouts_take_no_calibration(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="scene.calibration: expected none for scene.reader=colmap"):
        open_source(SceneConfig(reader="colmap", path=str(tmp_path), calibration="rig.toml"))
