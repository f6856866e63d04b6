"""The D-NeRF reader: pixels, cameras and times against hand-computed values, and every kind of invalid input."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from dnerf_folder import ANGLE_X, SIZE, blender_pose, edit, read, write_folder, write_json, write_split
from PIL import Image

from datasets.composition import compose
from datasets.files.errors import SceneError


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_folder(tmp_path)


# --- pixels -----------------------------------------------------------------------------------------------------------


def test_alpha_is_applied_once() -> None:
    rgba = np.full((1, 1, 4), (200, 100, 0, 128), dtype=np.uint8)
    # 200 · 128/255 = 100.4 and 100 · 128/255 = 50.2; white adds 255 - 128 = 127. Twice would give 50 over black.
    assert compose(rgba, (0.0, 0.0, 0.0)).tolist() == [[[100, 50, 0]]]
    assert compose(rgba, (1.0, 1.0, 1.0)).tolist() == [[[227, 177, 127]]]


def test_colour_of_transparent_pixels_is_ignored() -> None:
    rgba = np.zeros((2, 2, 4), dtype=np.uint8)
    rgba[..., :3] = 255  # white everywhere
    rgba[0, 0] = (255, 0, 0, 255)  # only one pixel is opaque: red
    assert compose(rgba, (0.0, 0.0, 0.0), 2).tolist() == [[[64, 0, 0]]]  # 255 / 4 = 63.75


@pytest.mark.parametrize("background", [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (0.2, 0.5, 0.9)])
def test_downscale_averages_premultiplied_colour_and_alpha(background: tuple) -> None:
    rgba = np.random.default_rng(0).integers(0, 256, (SIZE, SIZE, 4), dtype=np.uint8)
    straight, alpha = rgba[..., :3] / 255, rgba[..., 3:] / 255
    blocks = [values.reshape(SIZE // 2, 2, SIZE // 2, 2, -1).mean(axis=(1, 3)) for values in (straight * alpha, alpha)]
    expected = 255 * (blocks[0] + np.array(background) * (1 - blocks[1]))
    # Rounded once: half a level, and float32 rounding.
    np.testing.assert_allclose(compose(rgba, background, 2), expected, atol=0.5 + 1e-3)


def test_incomplete_blocks_are_cropped_from_image_and_camera(folder: Path) -> None:
    scene = read(folder, downscale=3)  # 8 = 2 · 3 + 2
    camera = scene.train[0].camera
    assert scene.train[0].image.shape == (2, 2, 3) and (camera.width, camera.height) == (2, 2)
    assert (camera.cx, camera.cy) == pytest.approx((SIZE / 2 / 3, SIZE / 2 / 3))  # not the centre of the cropped image
    assert camera.fx == pytest.approx(0.5 * SIZE / math.tan(0.5 * ANGLE_X) / 3)
    rgba = np.asarray(Image.open(folder / "train" / "r_0.png"))[:3, :3] / 255
    expected = 255 * (rgba[..., :3] * rgba[..., 3:]).mean(axis=(0, 1))
    np.testing.assert_allclose(scene.train[0].image[0, 0], expected, atol=0.501)  # rounded once


def test_image_smaller_than_downscale_is_refused(folder: Path) -> None:
    with pytest.raises(SceneError, match="at least 16 pixels a side .* found 8 x 8"):
        read(folder, downscale=16)


def test_image_without_alpha_is_opaque(folder: Path) -> None:
    Image.fromarray(np.full((SIZE, SIZE, 3), 77, dtype=np.uint8)).save(folder / "train" / "r_1.png")
    assert (read(folder, background=(1.0, 1.0, 1.0)).train[1].image == 77).all()


@pytest.mark.parametrize(
    ("hidden", "background"), [((255, 255, 255), 1.0), ((250, 253, 255), 1.0), ((0, 0, 0), 0.0), (None, 0.0)]
)
def test_what_transparent_pixels_hide_is_the_background(folder: Path, hidden: tuple | None, background: float) -> None:
    """Their one colour, white within a tolerance of 8 levels; several colours (None) are none, and black is composed
    over."""
    rng = np.random.default_rng(1)
    for path in (folder / "train").glob("*.png"):
        rgba = rng.integers(0, 256, (SIZE, SIZE, 4), dtype=np.uint8)
        rgba[..., 3] = 255
        rgba[:, : SIZE // 2, 3] = 0
        if hidden is not None:
            rgba[:, : SIZE // 2, :3] = hidden
        Image.fromarray(rgba).save(path)
    lines: list[str] = []
    scene = read(folder, lines.append, background="auto")
    assert scene.background == (background,) * 3
    assert ["scene.background: white" in line for line in lines] == ([True] if background else [])
    assert (np.asarray(scene.train[0].image)[:, : SIZE // 4] == 255 * background).all()
    assert read(folder).background == (0.0, 0.0, 0.0), "as set"


# --- cameras, times, splits -------------------------------------------------------------------------------------------


def test_cameras_at_half_resolution(folder: Path) -> None:
    scene = read(folder)
    camera = scene.train[2].camera
    focal = 0.5 * (SIZE / 2) / math.tan(0.5 * ANGLE_X)
    assert (camera.width, camera.height, camera.cx, camera.cy) == (SIZE // 2, SIZE // 2, SIZE / 4, SIZE / 4)
    assert camera.fx == pytest.approx(focal, rel=1e-12) and camera.fy == pytest.approx(focal, rel=1e-12)
    np.testing.assert_allclose(camera.position, [2.0, 0.0, 4.0], atol=1e-12)
    # The world's origin lies 4 in front and 2 to the left; world y points up, towards smaller image y.
    np.testing.assert_allclose(camera.world_to_cam @ [0.0, 0.0, 0.0, 1.0], [-2.0, 0.0, 4.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(camera.world_to_cam @ [0.0, 1.0, 0.0, 1.0], [-2.0, -1.0, 4.0, 1.0], atol=1e-12)
    assert scene.extent == pytest.approx(1.1 * 1.0, rel=1e-12)


def test_times_and_view_names(folder: Path) -> None:
    scene = read(folder)
    assert [view.time for view in scene.train] == [0.0, 0.5, 1.0]
    assert [view.name for view in scene.train + scene.test] == [
        "train/r_0",
        "train/r_1",
        "train/r_2",
        "test/r_000",
        "test/r_001",
    ]
    assert (scene.time_start, scene.duration) == (0.0, 1.0) and scene.capture != "static"


def test_val_as_the_held_out_split(folder: Path) -> None:
    (folder / "transforms_test.json").unlink()
    assert [view.name for view in read(folder, test_split="val").test] == ["val/r_0", "val/r_1"]


@pytest.mark.parametrize("spelled", [lambda path: path + ".png", lambda path: path.replace("/", "\\")])
def test_file_path_with_suffix_or_of_windows(folder: Path, spelled: Callable[[str], str]) -> None:
    before = read(folder)
    edit(folder, lambda c: [entry.update(file_path=spelled(entry["file_path"])) for entry in c["frames"]])
    after = read(folder)
    assert [view.name for view in after.train] == [view.name for view in before.train]
    assert all((a.image == b.image).all() for a, b in zip(after.train, before.train))


def test_file_with_a_byte_order_mark(folder: Path) -> None:
    path = folder / "transforms_train.json"
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert [view.time for view in read(folder).train] == [0.0, 0.5, 1.0]


@pytest.mark.parametrize(("step", "start"), [(149.0, 0.0), (5000.0, -200.0), (5.0, 1.7e9), (0.4, 0.1), (1.0, 3.0)])
def test_times_in_other_units_set_start_and_duration(folder: Path, step: float, start: float) -> None:
    for split in ("train", "test"):
        edit(folder, lambda c: [e.update(time=start + step * e["time"]) for e in c["frames"]], split)
    scene = read(folder)
    assert [view.time for view in scene.train] == [start, start + 0.5 * step, start + step]
    assert (scene.time_start, scene.duration) == (start, pytest.approx(step)) and scene.capture != "static"


@pytest.mark.parametrize("times", [(0.0, 0.2, 0.5), (0.0, 0.4, 0.5)])
def test_irregular_times_in_the_unit_interval_are_no_outliers(folder: Path, times: tuple[float, ...]) -> None:
    edit(folder, lambda c: [e.update(time=t) for e, t in zip(c["frames"], times, strict=True)])
    edit(folder, lambda c: [e.update(time=times[1]) for e in c["frames"]], "test")
    scene = read(folder)
    assert tuple(view.time for view in scene.train) == times
    assert (scene.time_start, scene.duration) == (times[0], pytest.approx(times[-1] - times[0]))


def write_times(root: Path, train: list[float], test: float) -> Path:
    """Training views of these times and a test view."""
    write_split(root, "train", len(train))
    write_split(root, "test", 1)
    edit(root, lambda c: [e.update(time=t) for e, t in zip(c["frames"], train, strict=True)])
    edit(root, lambda c: c["frames"][0].update(time=test), "test")
    return root


@pytest.mark.parametrize(
    ("train", "test"),
    [  # seconds; what is just above 1 s continues the others
        ([i / 30 for i in range(32) if i != 3], 0.5),
        ([i / 30 for i in range(31)], 1.1),
        ([i / 10 for i in range(11)], 1.02),
        ([i / 5 for i in range(6)], 1.6),
        ([0.0, 0.5, 1.0], 1.0 + 1e-9),
        ([0.0, 1.0], 2.0),
    ],
)
def test_times_just_above_1_are_no_outliers(tmp_path: Path, train: list[float], test: float) -> None:
    scene = read(write_times(tmp_path, train, test))
    assert scene.time_start == 0 and scene.duration == max(*train, test)


@pytest.mark.parametrize(
    ("train", "test"),
    [
        ([i / 30 for i in range(31)], 1.2),
        ([i / 10 for i in range(11)], 1.5),
        ([0.0, 0.5, 1.0], 1.3),
        ([0.0, 1.0], 10.0),
    ],
)
def test_times_that_do_not_continue_the_others_are_outliers(tmp_path: Path, train: list[float], test: float) -> None:
    with pytest.raises(SceneError, match=rf"test/r_000: expected a time in \[0, 1\].*, found {test:g}$"):
        read(write_times(tmp_path, train, test))


def test_times_over_most_of_the_unit_interval_keep_duration_1(folder: Path) -> None:
    for split in ("train", "test"):
        edit(folder, lambda c: [e.update(time=0.2 + 0.6 * e["time"]) for e in c["frames"]], split)
    assert (read(folder).time_start, read(folder).duration) == (0.0, 1.0)


def test_scene_without_times_is_static(tmp_path: Path) -> None:
    for split in ("train", "test"):
        write_split(tmp_path, split, 2, timed=False)
    scene = read(tmp_path)
    assert scene.capture == "static" and {view.time for view in scene.train + scene.test} == {0.0}


# --- invalid input ----------------------------------------------------------------------------------------------------


def entry(content: dict, **changes: object) -> None:
    content["frames"][1].update(changes)


def drop(key: str) -> Callable[[dict], None]:
    return lambda content: content["frames"][1].pop(key)


def with_pose(row: int, column: int, value: float) -> Callable[[dict], None]:
    def change(content: dict) -> None:
        content["frames"][1]["transform_matrix"][row][column] = value

    return change


def truncate(folder: Path) -> None:
    path = folder / "train" / "r_1.png"
    path.write_bytes(path.read_bytes()[:-80])


def transforms(change: Callable[[dict], None]) -> Callable[[Path], None]:
    return lambda folder: edit(folder, change)


INVALID_INPUT: dict[str, tuple[Callable[[Path], object], str]] = {
    "json missing": (lambda f: (f / "transforms_test.json").unlink(), r"transforms_test\.json: expected a file"),
    "json invalid": (
        lambda f: (f / "transforms_train.json").write_text('{"frames": ['),
        r"transforms_train\.json: expected valid JSON, found Expecting value: line 1",
    ),
    "json not text": (lambda f: (f / "transforms_train.json").write_bytes(b"\xff\xfe\x00"), "expected valid JSON"),
    "json not an object": (lambda f: write_json(f / "transforms_train.json", []), "expected an object .* found list"),
    "no angle": (
        transforms(lambda c: c.pop("camera_angle_x")),
        "the key camera_angle_x, or fl_x, found only file_path",
    ),
    "angle zero": (
        transforms(lambda c: c.update(camera_angle_x=0.0)),
        r"camera_angle_x: expected .* \(0, π\).* found 0.0",
    ),
    "angle beyond π": (transforms(lambda c: c.update(camera_angle_x=3.2)), "found 3.2"),
    "angle NaN": (transforms(lambda c: c.update(camera_angle_x=float("nan"))), "found nan"),
    "angle a string": (transforms(lambda c: c.update(camera_angle_x="0.7")), "expected a number, found '0.7'"),
    "no frames key": (transforms(lambda c: c.pop("frames")), "the key frames, found only camera_angle_x"),
    "frames empty": (
        transforms(lambda c: c.update(frames=[])),
        "frames: expected .* at least one frame, found an empty",
    ),
    "frames not a list": (transforms(lambda c: c.update(frames={})), "frames: expected a list .* found dict"),
    "entry not an object": (transforms(lambda c: c.update(frames=[3])), r"frames\[0\]: expected an object, found int"),
    "no file_path": (transforms(drop("file_path")), r"frames\[1\]: expected the key file_path"),
    "no pose": (transforms(drop("transform_matrix")), r"frames\[1\]: expected the key transform_matrix"),
    "file_path empty": (transforms(lambda c: entry(c, file_path="")), "file_path: expected a file name, found ''"),
    "image missing": (
        lambda f: (f / "train" / "r_1.png").unlink(),
        r"r_1: expected an image, named by .*frames\[1\], found no such file, nor with \.png, ",
    ),
    "image empty": (lambda f: (f / "train" / "r_1.png").write_bytes(b""), r"r_1\.png: expected a readable image"),
    "image not a PNG": (
        lambda f: (f / "train" / "r_1.png").write_text("hello"),
        r"r_1\.png: expected a readable image",
    ),
    "image truncated": (truncate, r"r_1\.png: expected a readable image, found .*truncated"),
    "image of 16 bits in colour": (
        lambda f: cv2.imwrite(str(f / "train/r_1.png"), np.full((SIZE, SIZE, 3), 500, dtype=np.uint16)),
        r"r_1\.png: expected 8 bits a channel, found image mode RGB;16B",
    ),
    "image of 16 bits": (
        lambda f: Image.fromarray(np.zeros((SIZE, SIZE), dtype=np.uint16)).save(f / "train/r_1.png"),
        r"r_1\.png: expected 8 bits a channel, found image mode I;16",
    ),
    "one larger image": (
        lambda f: Image.new("RGBA", (SIZE + 1, SIZE)).save(f / "test" / "r_001.png"),
        r"r_001\.png: expected 8 x 8 pixels as r_0\.png, found 9 x 8",
    ),
    "pose NaN": (transforms(with_pose(0, 3, float("nan"))), r"frames\[1\]: transform_matrix: .* found NaN or Inf"),
    "pose 3 x 4": (
        transforms(lambda c: c["frames"][1]["transform_matrix"].pop()),
        r"4 x 4 numbers, found shape \(3, 4\)",
    ),
    "pose ragged": (transforms(lambda c: c["frames"][1]["transform_matrix"][0].pop()), "4 x 4 numbers, found ragged"),
    "pose a string": (transforms(lambda c: entry(c, transform_matrix="identity")), "4 x 4 numbers, found"),
    "pose scaled": (transforms(with_pose(0, 0, 1.2)), r"a rigid pose .* up to 0\.44"),
    "pose mirrored": (transforms(with_pose(0, 0, -1.0)), "a rigid pose .* det R -1"),
    "pose projective": (transforms(with_pose(3, 0, 0.5)), r"a rigid pose .* last row \[0.5"),
    "time in another unit": (
        transforms(lambda c: entry(c, time=1.7e9 + 0.25)),
        r"train/r_1: expected a time in \[0, 1\], as the other frames have, found 1700000000\.25",
    ),
    "time after the end": (
        transforms(lambda c: entry(c, time=1.5)),
        r"train/r_1: expected a time in \[0, 1\].* found 1.5",
    ),
    "time far before": (transforms(lambda c: entry(c, time=-20.0)), r"train/r_1: .* found -20"),
    "time infinite": (
        transforms(lambda c: entry(c, time=float("inf"))),
        r"frames\[1\]: time: expected a finite time, found inf",
    ),
    "time NaN": (transforms(lambda c: entry(c, time=float("nan"))), "time: expected a finite time, found nan"),
    "time null": (transforms(lambda c: entry(c, time=None)), "time: expected a number, found None"),
    "time in some entries only": (transforms(drop("time")), "train/r_1: expected a time in every frame or in none"),
    "time in train only": (
        lambda f: edit(f, lambda c: [x.pop("time") for x in c["frames"]], "test"),
        "in 2 of 5 frames",
    ),
    "one camera position": (
        transforms(lambda c: [x.update(transform_matrix=blender_pose(0.0)) for x in c["frames"]]),
        "two places or more .* found 3 at one place",
    ),
    "the same image twice": (transforms(lambda c: entry(c, file_path="./train/r_0")), "train/r_0 twice"),
}


@pytest.mark.parametrize("case", INVALID_INPUT)
def test_invalid_input_is_refused_in_one_line(folder: Path, case: str) -> None:
    damage, message = INVALID_INPUT[case]
    damage(folder)
    with pytest.raises(SceneError, match=message) as caught:
        read(folder)
    assert "\n" not in str(caught.value)
    assert str(folder) in str(caught.value)  # the message has the full path


@pytest.mark.parametrize(("make", "found"), [(lambda p: None, "nothing there"), (lambda p: p.write_text(""), "a file")])
def test_path_must_be_a_folder(tmp_path: Path, make: Callable[[Path], object], found: str) -> None:
    make(tmp_path / "scene")
    with pytest.raises(SceneError, match=f"expected a folder in the layout of dnerf, found {found}"):
        read(tmp_path / "scene")
