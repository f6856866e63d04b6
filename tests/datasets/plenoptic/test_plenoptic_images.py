"""The image form of the Plenoptic layout: frames, poses, intrinsics, and every kind of invalid input."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from dnerf_folder import blender_pose
from PIL import Image
from plenoptic_folder import HEIGHT, WIDTH, picture, read, write_camera

from datasets.files.errors import SceneError
from datasets.files.frame_store import StoredFrame
from datasets.source import detect

FRAMES = 3
# Like the released program's converter: sizes are floats, the principal point is an integer.
INTRINSICS = {"w": 64.0, "h": 48.0, "fl_x": 50.0, "fl_y": 51.0, "cx": 32, "cy": 24}


def entries(camera: int) -> list[dict]:
    return [
        {
            "file_path": f"images/cam{camera:02d}_{frame:04d}",
            "transform_matrix": blender_pose(camera),
            "time": frame / 30,
        }
        for frame in range(FRAMES)
    ]


@pytest.fixture(scope="session")
def converted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("converted")
    (folder / "images").mkdir()
    for camera in range(3):
        for frame in range(FRAMES):
            Image.fromarray(picture(camera, frame)).save(folder / "images" / f"cam{camera:02d}_{frame:04d}.png")
    for split, cameras in (("train", (2, 1)), ("test", (0,))):
        frames = [entry for camera in cameras for entry in entries(camera)[::-1]]  # in any order
        (folder / f"transforms_{split}.json").write_text(json.dumps({**INTRINSICS, "frames": frames}))
    return folder


@pytest.fixture
def folder(converted: Path, tmp_path: Path) -> Path:
    return shutil.copytree(converted, tmp_path / "scene")


def edit(folder: Path, change: Callable[[dict], object], split: str = "train") -> None:
    path = folder / f"transforms_{split}.json"
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def test_the_layout_is_detected(folder: Path) -> None:
    assert detect(folder)[0] == "plenoptic"
    edit(folder, lambda content: content["frames"][1].update(transform_matrix=blender_pose(0.5)))  # a camera moves
    assert detect(folder)[0] == "dnerf"
    (folder / "transforms_train.json").write_text("[1")
    assert detect(folder)[0] == "dnerf"  # which says what is wrong


def test_images_become_stored_frames(folder: Path) -> None:
    scene = read(folder)
    assert [view.name for view in scene.train] == [f"train/cam{c:02d}_{f:04d}" for c in (1, 2) for f in range(FRAMES)]
    assert [view.name for view in scene.test] == [f"test/cam00_{f:04d}" for f in range(FRAMES)]
    for view in scene.train + scene.test:
        camera, frame = view.name.split("/cam")[1].split("_")
        assert isinstance(view.image, StoredFrame)
        assert np.array_equal(np.asarray(view.image), picture(int(camera), int(frame)))
    assert [view.time for view in scene.test] == pytest.approx([0, 1 / 30, 2 / 30])
    assert (scene.duration, scene.frame_rate) == (pytest.approx(0.1), pytest.approx(30))
    assert scene.unit == pytest.approx(1.1 * 0.5)  # parallel axes: 3DGS's extent of the cameras at x = 1 and 2


def test_cameras_have_blender_axes_and_the_files_intrinsics(folder: Path) -> None:
    camera = read(folder, downscale=2).train[0].camera  # cam01
    assert (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy) == (32, 24, 25, 25.5, 16, 12)
    np.testing.assert_allclose(camera.position, [1, 0, 4], atol=1e-12)
    # The world's origin lies 4 in front and 1 to the left; world y points up, towards smaller image y.
    np.testing.assert_allclose(camera.world_to_cam @ [0, 0, 0, 1], [-1, 0, 4, 1], atol=1e-12)
    np.testing.assert_allclose(camera.world_to_cam @ [0, 1, 0, 1], [-1, -1, 4, 1], atol=1e-12)


def test_test_cameras_setting(folder: Path) -> None:
    assert {view.name[:10] for view in read(folder, test_cameras=[2]).test} == {"test/cam02"}


def written_anew(folder: Path, train: list[dict], test: list[dict]) -> None:
    for split, frames in (("train", train), ("test", test)):
        (folder / f"transforms_{split}.json").write_text(json.dumps({**INTRINSICS, "frames": frames}))


def test_the_cameras_of_the_test_file_are_held_out(folder: Path) -> None:
    written_anew(folder, entries(0) + entries(1), entries(2))
    assert {view.name[:10] for view in read(folder).test} == {"test/cam02"}
    assert {view.name[:10] for view in read(folder, test_cameras=[1]).test} == {"test/cam01"}


def test_times_that_the_test_file_holds_out_are_left_to_the_reader_of_d_nerf(folder: Path) -> None:
    frames = [entry for camera in range(3) for entry in entries(camera)]
    written_anew(folder, [f for i, f in enumerate(frames) if i % 3 != 1], frames[1::3])
    assert detect(folder)[0] == "dnerf"


def test_intrinsics_at_another_scale_and_of_single_entries(folder: Path) -> None:
    edit(folder, lambda c: c.update(w=128, h=96))
    edit(folder, lambda c: [e.update(fl_x=90.0) for e in c["frames"] if "cam02" in e["file_path"]])
    first, second = (read(folder).train[index].camera for index in (0, FRAMES))
    assert (first.fx, first.fy, first.cx, first.cy) == (25, 25.5, 16, 12)
    assert (second.fx, second.fy) == (45, 25.5)


def test_camera_angle_x_alone_is_centred(folder: Path) -> None:
    for split in ("train", "test"):
        edit(folder, lambda c: [c.pop(key) for key in INTRINSICS] and c.update(camera_angle_x=0.7), split)
    camera = read(folder).train[0].camera
    assert camera.fx == camera.fy == pytest.approx(0.5 * WIDTH / math.tan(0.35))
    assert (camera.cx, camera.cy) == (WIDTH / 2, HEIGHT / 2)


def test_distorted_images_are_undistorted(folder: Path) -> None:
    plain = read(folder, test_cameras=[0])
    edit(folder, lambda c: c.update(k1=-0.2, camera_model="OPENCV"))
    undistorted = read(folder, test_cameras=[0])
    assert not np.array_equal(plain.train[0].image, undistorted.train[0].image)
    assert np.array_equal(plain.test[0].image, undistorted.test[0].image)  # transforms_test.json has none
    assert undistorted.train[0].camera.fx == 50


def test_transparent_pixels_show_the_background(folder: Path) -> None:
    clear = np.zeros((HEIGHT, WIDTH, 4), dtype=np.uint8)
    Image.fromarray(clear).save(folder / "images" / "cam01_0001.png")
    image = np.asarray(read(folder, background=(1.0, 0.0, 0.2)).train[1].image)
    assert (image == (255, 0, 51)).all()
    assert not np.asarray(read(folder).train[1].image).any()  # over black, in another store


def test_first_frame_and_a_single_frame(folder: Path) -> None:
    scene = read(folder, first_frame=1, frames=1)
    assert [view.name for view in scene.test] == ["test/cam00_0001"] and scene.test[0].time == 0
    assert np.array_equal(scene.test[0].image, picture(0, 1))


def test_one_frame_per_camera_is_a_static_scene(folder: Path) -> None:
    for split in ("train", "test"):
        edit(folder, lambda c: c.update(frames=[e for e in c["frames"] if e["time"] == 0]), split)
    scene = read(folder)
    assert scene.capture == "static" and scene.frame_rate == 30


@pytest.mark.parametrize(
    ("clock", "playback_rate"), [(lambda s: 1e3 * s, 30), (lambda s: 30 * s, 30), (lambda s: 0.8 * s, 37.5)]
)
def test_times_in_any_unit(folder: Path, clock: Callable[[float], float], playback_rate: float) -> None:
    """Rates that cannot be per second give a playback rate of 30."""
    for split in ("train", "test"):
        edit(folder, lambda c: [e.update(time=clock(e["time"])) for e in c["frames"]], split)
    scene = read(folder)
    assert [view.time for view in scene.test] == pytest.approx([clock(frame / 30) for frame in range(FRAMES)])
    assert scene.frame_rate == pytest.approx(30 / clock(1)) and scene.playback_rate == pytest.approx(playback_rate)


def test_rounded_times_since_1970_are_synchronised(folder: Path) -> None:
    for split in ("train", "test"):
        edit(folder, lambda c: [e.update(time=1.7e9 + e["time"]) for e in c["frames"]], split)
    edit(folder, lambda c: c.update(frames=[e for e in c["frames"] if not e["file_path"].endswith("cam02_0002")]))
    scene = read(folder, frames=2)
    assert [view.time for view in scene.test] == pytest.approx([0, 1 / 30], abs=1e-6)  # rounding is 1.2e-7


def test_images_have_the_times_of_the_file(folder: Path) -> None:
    """Camera 1 starts 0.4 frames late, and its second image is another 0.3 late."""
    late = {0: 0.4, 1: 0.7, 2: 0.4}

    def shift(content: dict) -> None:
        for entry in content["frames"]:
            if "cam01" in entry["file_path"]:
                entry["time"] += late[int(entry["file_path"][-4:])] / 30

    edit(folder, shift)
    scene = read(folder)
    found = {view.name: view.time * 30 for view in scene.train + scene.test}
    for frame in range(FRAMES):
        assert found[f"train/cam01_{frame:04d}"] == pytest.approx(frame + late[frame], abs=1e-9)
        assert found[f"train/cam02_{frame:04d}"] == found[f"test/cam00_{frame:04d}"] == pytest.approx(frame, abs=1e-9)
    assert scene.capture == "multi_view" and scene.frame_spacing == pytest.approx(1 / 30)


def test_videos_with_poses_take_precedence(folder: Path) -> None:
    for number in range(3):
        write_camera(folder / f"cam{number:02d}.mp4", number)
    assert read(folder).train[0].image.shape == (HEIGHT, WIDTH, 3)  # without poses_bounds.npy: the images
    (folder / "poses_bounds.npy").write_text("hello")
    with pytest.raises(SceneError, match="poses_bounds.npy: expected a numpy array"):
        read(folder)


# --- invalid input ----------------------------------------------------------------------------------------------------


def frame(**changes: object) -> Callable[[Path], None]:
    """Changes cam02's frame 1 (frames[1] of train)."""
    return lambda folder: edit(folder, lambda content: content["frames"][1].update(changes))


def every(camera: int, change: Callable[[dict], object], split: str = "train") -> Callable[[Path], None]:
    return lambda folder: edit(
        folder, lambda content: [change(e) for e in content["frames"] if f"cam{camera:02d}" in e["file_path"]], split
    )


def file(**changes: object) -> Callable[[Path], None]:
    return lambda folder: edit(folder, lambda content: content.update(changes))


def truncate(folder: Path) -> None:
    path = folder / "images" / "cam02_0001.png"
    path.write_bytes(path.read_bytes()[:-60])


def resize(folder: Path, camera: int, frames: range) -> None:
    for index in frames:
        Image.new("RGB", (WIDTH + 2, HEIGHT)).save(folder / "images" / f"cam{camera:02d}_{index:04d}.png")


WHERE = r"transforms_train\.json: frames\[1\]"
INVALID_INPUT: dict[str, tuple[Callable[[Path], object], str]] = {
    "no test file": (
        lambda f: (f / "transforms_test.json").unlink(),
        r"transforms_test\.json: expected a transforms file, found none",
    ),
    "json invalid": (lambda f: (f / "transforms_train.json").write_text("{"), r"transforms_train\.json: .*valid JSON"),
    "image missing": (
        lambda f: (f / "images" / "cam02_0001.png").unlink(),
        rf"cam02_0001: expected an image, named by .*{WHERE}, found no such file",
    ),
    "image not one": (
        lambda f: (f / "images" / "cam02_0001.png").write_text("hello"),
        r"cam02_0001\.png: expected a readable image",
    ),
    "image truncated": (truncate, r"cam02_0001\.png: expected a readable image"),
    "one larger image": (
        lambda f: resize(f, 2, range(1, 2)),
        r"cam02_0001\.png: expected 64 x 48 pixels as cam02_0000\.png, found 66 x 48",
    ),
    "one larger camera": (
        lambda f: resize(f, 2, range(FRAMES)),
        r"cam02_0000\.png: expected 64 x 48 pixels as cam00_0000\.png, found 66 x 48: "
        r"unsynchronised; scene\.drop_cameras=\[2\] leaves camera 2 out",
    ),
    "name without number": (
        lambda f: (shutil.copy(f / "images/cam02_0001.png", f / "images/left.png"), frame(file_path="images/left")(f)),
        rf"{WHERE}: file_path: expected a name like images/cam00_0000, found images/left",
    ),
    "no time": (
        lambda f: edit(f, lambda c: c["frames"][1].pop("time")),
        rf"{WHERE}: time: expected a number within ±1e\+19, found none",
    ),
    "time NaN": (frame(time=float("nan")), rf"{WHERE}: time: expected a finite time, found nan"),
    "time out of step": (frame(time=0.058), rf"{WHERE}: time: expected 0\.0333\d*, at equal steps .* found 0\.058$"),
    "times all alike": (
        every(2, lambda e: e.update(time=0.5)),
        "time: expected a time after that of frame 0, 0.5, found",
    ),
    "other rate": (
        every(2, lambda e: e.update(time=2 * e["time"])),
        r"cam02_0000\.png: expected 30 frames a second .* found 15: unsynchronised; scene\.drop_cameras",
    ),
    "later start": (
        every(2, lambda e: e.update(time=e["time"] + 0.1)),
        r"cam02_0000\.png: expected a first frame at 0 .* found a first frame at 3",
    ),
    "frame left out": (lambda f: edit(f, lambda c: c["frames"].pop(1)), "expected frame 1 of its camera next, found 2"),
    "frame twice": (frame(file_path="images/cam02_0000"), "expected frame 1 of its camera next, found 0"),
    "last frame missing": (
        lambda f: edit(f, lambda c: c["frames"].pop(0)),
        r"expected 3 frames as cam00_0000\.png, found 2: unsynchronised",
    ),
    "pose NaN": (frame(transform_matrix=[[float("nan")] * 4] * 4), rf"{WHERE}: transform_matrix: .* found NaN or Inf"),
    "pose moves": (
        frame(transform_matrix=blender_pose(2.5)),
        rf"{WHERE}: transform_matrix: expected the pose of cam02_0000\.png, for cameras do not move",
    ),
    "no focal length": (lambda f: edit(f, lambda c: c.pop("fl_x")), "expected the key camera_angle_x"),
    "focal a string": (file(fl_x="50"), "fl_x: expected a number, found '50'"),
    "focal negative": (file(fl_x=-50.0), "expected finite intrinsics, fl_x and fl_y > 0, found -50"),
    "other shape": (file(w=100), "expected w x h of 64 x 48 or the same shape at another scale, found 100 x 48"),
    "fisheye": (file(camera_model="OPENCV_FISHEYE"), "camera_model: expected PINHOLE, .* found 'OPENCV_FISHEYE'"),
    "fisheye by flag": (file(is_fisheye=True), "camera_model: expected PINHOLE, .* found a fisheye"),
}


@pytest.mark.parametrize("case", INVALID_INPUT)
def test_invalid_input_is_refused_in_one_line(folder: Path, case: str) -> None:
    damage, message = INVALID_INPUT[case]
    damage(folder)
    with pytest.raises(SceneError, match=message) as caught:
        read(folder)
    assert "\n" not in str(caught.value) and str(folder) in str(caught.value)
    if case != "image truncated":  # detected only while decoding
        assert not (folder.parent / "cache").exists()
