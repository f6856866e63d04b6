"""nerfstudio's folder: splits, masks, lenses, cameras by folder, points."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from layout_folders import COUNT, HEIGHT, WIDTH, cameras, picture, write_nerfstudio
from layout_scenes import check, check_ramp, fisheye, read, write_ramp
from PIL import Image

from datasets.files.errors import SceneError
from datasets.photographs.points import read_ply_points
from datasets.scene import Scene, ScenePoints, View


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
    assert points_of(tmp_path, kind, [written])[0].colors.tolist() == [expected]


def points_of(folder: Path, kind: str, colors: list[str], names: str = "red green blue") -> tuple[ScenePoints, list]:
    """The points of a .ply that all lie at (1, 2, 3), and the lines on them."""
    properties = [*(f"float {axis}" for axis in "xyz"), *(f"{kind} {color}" for color in names.split())]
    header = ["ply", "format ascii 1.0", f"element vertex {len(colors)}", *(f"property {p}" for p in properties)]
    (folder / "points.ply").write_text("\n".join([*header, "end_header", *(f"1 2 3 {c}" for c in colors), ""]))
    lines: list[str] = []
    points = read_ply_points(folder / "points.ply", lines.append)
    assert points is not None
    return points, lines


def test_colours_of_16_bits_are_divided_by_257(tmp_path: Path) -> None:
    points, lines = points_of(tmp_path, "ushort", [f"{257 * c} {257 * (255 - c)} 65535" for c in range(0, 256, 5)])
    assert points.colors.tolist() == [[c, 255 - c, 255] for c in range(0, 256, 5)]
    assert lines == ["points: colours of 0 to 65535 are taken as 16 bits"]
    points, lines = points_of(tmp_path, "ushort", ["255 7 0"])  # 8 bits in a wider type, as LAS files have
    assert points.colors.tolist() == [[255, 7, 0]] and not lines


def test_one_row_does_not_decide_the_range_of_colours(tmp_path: Path) -> None:
    """A tenth of red is 25.5, rounded to even."""
    points, _ = points_of(tmp_path, "float", [*["0.1 0.2 1.0"] * 200, "7.5 0 0"])
    assert points.colors[0].tolist() == [26, 51, 255] and points.colors[-1].tolist() == [255, 0, 0]


def test_colours_that_are_none_are_said(tmp_path: Path) -> None:
    points, lines = points_of(tmp_path, "float", ["-1.7 0 1.7"] * 3)
    assert (points.colors == 128).all() and "colours of -1.7 to 1.7, which is none of 0 to 1, 255 and 65535" in lines[0]
    points, lines = points_of(tmp_path, "uchar", ["1 2 3"], "a b c")
    assert (points.colors == 128).all() and "no red, green and blue among x, y, z, a, b, c: grey points" in lines[0]
    assert points_of(tmp_path, "uchar", ["1 2 3"], "diffuse_red diffuse_green diffuse_blue")[0].colors.tolist() == [
        [1, 2, 3]
    ]


def masks(root: Path, write: Callable[[np.ndarray, Path], object]) -> tuple[Scene, list[str]]:
    """The scene after write(half, path) of each mask; half: (HEIGHT, WIDTH) uint8, 255 on the right."""
    half = np.zeros((HEIGHT, WIDTH), np.uint8)
    half[:, WIDTH // 2 :] = 255
    for path in (write_nerfstudio(root) / "masks").iterdir():
        write(half, path)
    return read(root)


@pytest.mark.parametrize("color", [255, 0, None])
def test_masks_in_alpha(tmp_path: Path, color: int | None) -> None:
    """White, black or the same mask beside it."""

    def write(half: np.ndarray, path: Path) -> None:
        grey = half if color is None else np.full_like(half, color)
        Image.fromarray(np.dstack([grey, grey, grey, half])).save(path)

    scene, lines = masks(tmp_path, write)
    right = np.arange(WIDTH)[None].repeat(HEIGHT, axis=0) >= WIDTH // 2
    assert all(np.array_equal(view.mask, right) for view in (*scene.train, *scene.test))
    assert "masks: 50 % of the pixels count" in lines


def test_masks_that_contradict_themselves_are_refused(tmp_path: Path) -> None:
    def write(half: np.ndarray, path: Path) -> None:
        quarter = np.roll(half, WIDTH // 4, axis=1)
        Image.fromarray(np.dstack([half, half, half, half & quarter])).save(path)

    with pytest.raises(SceneError, match=r"found two that differ: 50 % by colour, 25 % by alpha$"):
        masks(tmp_path, write)


def test_masks_as_jpeg(tmp_path: Path) -> None:
    """Whose black is up to 5 of 255. A block of 8 pixels holds the edge at 20, where noise may reach 127."""
    scene, _ = masks(tmp_path, lambda half, path: Image.fromarray(half).save(path, format="JPEG", quality=60))
    assert scene.train[0].mask is not None
    assert not scene.train[0].mask[:, : WIDTH // 2].any() and scene.train[0].mask[:, WIDTH // 2 :].all()


@pytest.mark.parametrize("inverted", [False, True])
def test_masks_that_leave_out_the_points_may_be_inverted(tmp_path: Path, inverted: bool) -> None:
    """A disc in the middle, where the points are, counts or does not."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    disc = np.hypot(columns + 0.5 - WIDTH / 2, rows + 0.5 - HEIGHT / 2) < 10

    def write(half: np.ndarray, path: Path) -> None:
        Image.fromarray(np.where(disc != inverted, 255, 0).astype(np.uint8)).save(path)

    rng = np.random.default_rng(0)
    write_nerfstudio(tmp_path)
    points = rng.uniform(-0.2, 0.2, (50, 3))
    header = ["ply", "format ascii 1.0", "element vertex 50", *(f"property float {a}" for a in "xyz"), "end_header"]
    (tmp_path / "points.ply").write_text("\n".join([*header, *(f"{x} {y} {z}" for x, y, z in points), ""]))
    content = json.loads((tmp_path / "transforms.json").read_text()) | {"ply_file_path": "points.ply"}
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    for path in (tmp_path / "masks").iterdir():
        write(disc, path)
    said = [line for line in read(tmp_path)[1] if "may be inverted" in line]
    assert said == (
        ["masks: only 0 % of the points in the images lie where pixels count: the masks may be inverted (0 leaves out)"]
        if inverted
        else []
    )


@pytest.mark.parametrize("value, said", [(255, "masks: 100 % of the pixels count; they leave out nothing"), (0, None)])
def test_masks_of_one_value(tmp_path: Path, value: int, said: str | None) -> None:
    write = lambda half, path: Image.fromarray(np.full_like(half, value)).save(path)  # noqa: E731
    if said:
        assert said in masks(tmp_path, write)[1]
    else:
        with pytest.raises(SceneError, match="found masks of 0 alone: no pixel would count$"):
            masks(tmp_path, write)


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
