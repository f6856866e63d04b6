"""nerfstudio's folder: splits, masks, lenses, cameras by folder, points."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from layout_folders import COUNT, HEIGHT, WIDTH, cameras, picture, write_nerfstudio
from layout_scenes import check, check_ramp, fisheye, read, write_ramp
from PIL import Image

from datasets.files.errors import SceneError
from datasets.readers.nerfstudio import read_ply_points
from datasets.scene import View


def test_nerfstudio(tmp_path: Path) -> None:
    scene, lines = read(write_nerfstudio(tmp_path))
    check(scene)
    assert "taken for nerfstudio" in lines[0]
    assert scene.points is not None and scene.points.positions.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert all(view.mask is not None and view.mask.sum() == WIDTH * HEIGHT // 2 for view in scene.train)


def test_nerfstudio_splits_and_missing_masks(tmp_path: Path) -> None:
    scene, _ = read(write_nerfstudio(tmp_path, val_filenames=["images/frame_00003.png"]))
    assert [view.name for view in scene.test] == ["test/frame_00003"] and scene.test_split == "the layout's test frames"
    (tmp_path / "masks/frame_00002.png").unlink()
    with pytest.raises(SceneError, match="expected the mask of frame_00002, found no such file"):
        read(tmp_path)


def test_folders_of_several_cameras_count_alike(tmp_path: Path) -> None:
    """Four numbers in each of three folders are four times."""
    write_nerfstudio(tmp_path)
    content = json.loads((tmp_path / "transforms.json").read_text())
    for index, frame in enumerate(content["frames"]):
        moved = f"images/cam{2 - index // 4}/{index % 4:04d}.png"
        (tmp_path / moved).parent.mkdir(exist_ok=True)
        (tmp_path / frame["file_path"]).rename(tmp_path / moved)
        frame["file_path"] = moved
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    scene, lines = read(tmp_path)
    assert any("times: the numbers in the file names" in line for line in lines)
    assert scene.test_split == "camera 0 (cam0)" and "held out: camera 0 (cam0)" in lines  # the last one of the file
    assert [view.time for view in scene.test] == [0, 1, 2, 3] and scene.capture == "multi_view"
    shown = {(view.time, view.camera.world_to_cam.tobytes()): np.asarray(view.image) for view in scene.train}
    for index in range(COUNT - 4):
        key = next(key for key in shown if key[0] == index % 4 and np.array_equal(shown[key], picture(index)))
        np.testing.assert_allclose(np.frombuffer(key[1]).reshape(4, 4), cameras()[index].world_to_cam, atol=1e-6)


def frames(*numbers: int) -> list[str]:
    return [f"images/frame_{number:05d}.png" for number in numbers]


def names(views: tuple[View, ...]) -> list[int]:
    return [int(view.name[-5:]) for view in views]


def test_frames_outside_the_lists_are_left_out(tmp_path: Path) -> None:
    lists = {"train_filenames": frames(1, 2, 3, 4, 6), "val_filenames": frames(5), "test_filenames": frames(8, 5)}
    scene, lines = read(write_nerfstudio(tmp_path, **lists))
    assert names(scene.train) == [1, 2, 3, 4, 6] and names(scene.test) == [5, 8]
    assert scene.test_split == "the layout's test frames"
    assert "transforms.json: 5 of 12 frames are in no list of file names and left out" in lines


def test_of_train_filenames_alone_some_are_held_out(tmp_path: Path) -> None:
    scene, lines = read(write_nerfstudio(tmp_path, train_filenames=frames(*range(1, 10))))
    assert names(scene.test) == [5] and names(scene.train) == [1, 2, 3, 4, 6, 7, 8, 9]
    assert scene.test_split == "every 8th frame"
    assert "transforms.json: 3 of 12 frames are in no list of file names and left out" in lines


def test_frames_of_train_and_val_are_held_out(tmp_path: Path) -> None:
    scene, _ = read(write_nerfstudio(tmp_path, train_filenames=frames(*range(1, 13)), val_filenames=frames(2)))
    assert names(scene.test) == [2] and len(scene.train) == COUNT - 1


@pytest.mark.parametrize("key", ["train_filenames", "val_filenames", "test_filenames"])
def test_listed_names_that_are_no_frames_are_refused(tmp_path: Path, key: str) -> None:
    write_nerfstudio(tmp_path, **{key: [*frames(3), "images/frame_00004.jpg"]})
    expected = rf"transforms\.json: {key}: expected names that .* file_path, found 'images/frame_00004\.jpg'$"
    with pytest.raises(SceneError, match=expected):
        read(tmp_path)


@pytest.mark.parametrize("distortion", [{}, {"k1": -0.3, "p1": 0.002}])  # a lens that images all pixels
def test_masks_of_0_and_1_are_those_of_0_and_255(tmp_path: Path, distortion: dict) -> None:
    """The lens bends the edge of the mask across pixels, and downscale=2 averages it: only whole pixels count."""
    write_nerfstudio(tmp_path, **distortion)
    expected = [view.mask for view in read(tmp_path, downscale=2)[0].train]
    for path in (tmp_path / "masks").iterdir():
        Image.fromarray((np.asarray(Image.open(path)) > 0).astype(np.uint8)).save(path)
    found = [view.mask for view in read(tmp_path, downscale=2)[0].train]
    for mask, other in zip(found, expected, strict=True):
        assert mask is not None and mask[:, WIDTH // 4 + 1 :].all() and not mask[:, : WIDTH // 4 - 1].any()
        assert np.array_equal(mask, other)


def edit(root: Path, change: Callable[[dict], object]) -> Path:
    """Changes each frame of transforms.json."""
    content = json.loads((root / "transforms.json").read_text())
    for frame in content["frames"]:
        change(frame)
    (root / "transforms.json").write_text(json.dumps(content))
    return root


@pytest.mark.parametrize(
    "shared, coefficients",
    [
        ({"camera_model": "OPENCV_FISHEYE"}, ()),
        ({"camera_model": "OPENCV", "is_fisheye": True}, ()),
        ({"camera_model": "OPENCV_FISHEYE", "k1": 0.2, "k4": -0.2}, (0.2, 0, 0, -0.2)),
        ({"camera_model": "OPENCV_FISHEYE", "distortion_params": [0.2, -0.1, 0.3, -0.2, 0, 0]}, (0.2, -0.1, 0.3, -0.2)),
    ],
)
def test_fisheye(tmp_path: Path, shared: dict, coefficients: tuple[float, ...]) -> None:
    """A wide lens, on which each coefficient moves the outer pixels by levels of the ramp."""
    edit(write_nerfstudio(tmp_path, **shared), lambda frame: frame.update(fl_x=20.0, fl_y=20.0))
    write_ramp(tmp_path / "images")
    check_ramp(read(tmp_path)[0], fisheye(coefficients, 20.0), 20.0)


def test_windows_paths(tmp_path: Path) -> None:
    listed = [name.replace("/", "\\") for name in frames(3)]
    write_nerfstudio(tmp_path, val_filenames=listed, ply_file_path="points\\a.ply")
    (tmp_path / "points").mkdir()
    (tmp_path / "sparse_pc.ply").rename(tmp_path / "points/a.ply")
    keys = ("file_path", "mask_path")
    edit(tmp_path, lambda frame: frame.update({key: frame[key].replace("/", "\\") for key in keys}))
    scene, _ = read(tmp_path)
    check(scene)
    assert names(scene.test) == [3] and scene.points is not None and scene.train[0].mask is not None


@pytest.mark.parametrize(
    "kind, written, expected",
    [
        ("float", "1.0 0.5 0.25", [255, 128, 64]),  # × 255, rounded: 127.5 to even
        ("double", "0 1 0", [0, 255, 0]),
        ("float", "200.0 1.0 0.4", [200, 1, 0]),
        ("uchar", "1 0 1", [1, 0, 1]),
    ],
)
def test_colours_of_points(tmp_path: Path, kind: str, written: str, expected: list[int]) -> None:
    properties = [*(f"float {axis}" for axis in "xyz"), *(f"{kind} {color}" for color in ("red", "green", "blue"))]
    header = ["ply", "format ascii 1.0", "element vertex 1", *(f"property {p}" for p in properties), "end_header"]
    (tmp_path / "points.ply").write_text("\n".join([*header, f"1 2 3 {written}", ""]))
    points = read_ply_points(tmp_path / "points.ply")
    assert points is not None and points.colors.tolist() == [expected]


def changed(root: Path, change) -> Path:
    """The folder of write_nerfstudio after change(content) of its transforms.json."""
    content = json.loads((write_nerfstudio(root) / "transforms.json").read_text())
    change(content)
    (root / "transforms.json").write_text(json.dumps(content))
    return root


def test_timestamps_are_times(tmp_path: Path) -> None:
    def stamp(content: dict) -> None:
        for i, frame in enumerate(content["frames"]):
            frame["timestamp"] = 100 + 0.1 * i * i

    scene, _ = read(changed(tmp_path, stamp))
    views = sorted((*scene.train, *scene.test), key=lambda view: view.time)
    np.testing.assert_allclose([view.time for view in views], [100 + 0.1 * i * i for i in range(len(views))])


def test_poses_with_other_axes_are_refused(tmp_path: Path) -> None:
    """NeuS2's key for OpenCV's axes."""
    with pytest.raises(SceneError, match=r"from_na: expected poses with OpenGL's camera axes"):
        read(changed(tmp_path, lambda content: content.update(from_na=True)))


def test_the_path_of_the_file_itself_is_answered_with_its_folder(tmp_path: Path) -> None:
    root = write_nerfstudio(tmp_path)
    with pytest.raises(SceneError, match=re.escape(f"expected the folder of the data, {root}, found a file in it")):
        read(root / "transforms.json")


def test_cameras_that_are_asked_for_are_held_out_instead_of_the_lists(tmp_path: Path) -> None:
    def two_cameras(content: dict) -> None:
        for i, frame in enumerate(content["frames"]):
            name = f"images/{'ab'[i % 2]}/{i // 2:02d}.png"
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / frame["file_path"]).rename(tmp_path / name)
            frame["file_path"] = name
        content["val_filenames"] = [content["frames"][0]["file_path"]]

    changed(tmp_path, two_cameras)
    assert read(tmp_path)[0].test_split == "the layout's test frames"
    scene, _ = read(tmp_path, test_cameras=[1])
    assert scene.test_split == "camera 1 (b)" and len(scene.test) == 6
