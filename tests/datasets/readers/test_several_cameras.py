"""Which photographs of a layout one camera took, at which times, and which of them are trained on."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from layout_folders import write_nerfies, write_nerfstudio
from layout_scenes import read

from datasets.files.errors import SceneError
from datasets.scene import View


def rewritten(root: Path, change) -> None:
    """transforms.json after change(index, frame) of each frame, which may move its image."""
    content = json.loads((root / "transforms.json").read_text())
    for index, frame in enumerate(content["frames"]):
        before = frame["file_path"]
        change(index, frame)
        (root / frame["file_path"]).parent.mkdir(exist_ok=True)
        (root / before).rename(root / frame["file_path"])
    (root / "transforms.json").write_text(json.dumps(content))


def rig(root: Path, offset: float | None, count: int = 32, cameras: int = 4, name: str = "cam{}/{:04d}") -> Path:
    """Cameras that stand still, a folder each, 30 frames a second, each `offset` seconds later than the one before.

    None: without times.
    """
    write_nerfstudio(root, count)
    poses = [frame["transform_matrix"] for frame in json.loads((root / "transforms.json").read_text())["frames"]]

    def place(index: int, frame: dict) -> None:
        camera, number = index % cameras, index // cameras
        frame["file_path"] = f"images/{name.format(camera, number)}.png"
        frame["transform_matrix"] = poses[camera]
        if offset is not None:
            frame["time"] = number / 30 + camera * offset

    rewritten(root, place)
    return root


@pytest.mark.parametrize("offset", [0, 0.0006, 0.01])
def test_cameras_that_stand_still_may_have_times_of_their_own(tmp_path: Path, offset: float) -> None:
    scene, _ = read(rig(tmp_path, offset))
    assert scene.capture == "multi_view" and scene.test_split == "camera 0 (cam0)"
    assert scene.frame_spacing == pytest.approx(1 / 30, rel=1e-6) and len(scene.train) == 24


@pytest.mark.parametrize("offset", [0.0006, None])
def test_cameras_in_one_folder_are_told_apart_by_their_names(tmp_path: Path, offset: float | None) -> None:
    """Without times a number in the names is one, of all cameras alike."""
    scene, _ = read(rig(tmp_path, offset, name="cam{}_{:04d}"))
    assert scene.capture == "multi_view" and scene.test_split == "camera 0 (cam0)"
    assert scene.frame_spacing == pytest.approx(1 / 30 if offset else 1)


def test_names_of_a_camera_that_moves_tell_nothing(tmp_path: Path) -> None:
    write_nerfstudio(tmp_path)

    def rename(index: int, frame: dict) -> None:
        frame["file_path"] = f"images/{'ab'[index // 6]}_{index:04d}.png"  # two takes, say

    rewritten(tmp_path, rename)
    assert read(tmp_path)[0].capture == "clip"


def test_frames_of_each_camera_are_spread_evenly(tmp_path: Path) -> None:
    scene, _ = read(rig(tmp_path, 0.0006), frames=4)
    numbers = sorted(int(view.name[-4:].rpartition("_")[2]) for view in scene.train)
    assert numbers == sorted([0, 2, 5, 7] * 3), "4 of 8, of three cameras in training"


def test_of_two_cameras_both_are_held_out_at_times_of_their_own(tmp_path: Path) -> None:
    scene, _ = read(rig(tmp_path, 0, cameras=2))
    places = [view.camera.world_to_cam.tobytes() for view in scene.test]
    assert len(places) == 4 and len(set(places)) == 2
    assert len({view.time for view in scene.test}) == 4 and {v.time for v in scene.test} <= {
        v.time for v in scene.train
    }


def test_held_out_cameras_beside_a_clip_leave_it_a_clip(tmp_path: Path) -> None:
    """As DyCheck: one camera moves, and others, which only test, stand still."""
    write_nerfies(tmp_path)
    metadata = json.loads((tmp_path / "metadata.json").read_text())
    held_out = json.loads((tmp_path / "dataset.json").read_text())["val_ids"]
    for name in held_out:
        metadata[name]["camera_id"] = 1
    (tmp_path / "metadata.json").write_text(json.dumps(metadata))
    scene, _ = read(tmp_path)
    assert len(scene.test) == len(held_out) == 3 and scene.capture == "clip"


def alternating(root: Path, count: int = 30) -> Path:
    """As HyperNeRF's interpolation: of frames 0, 2, 4, … every second is held out."""
    write_nerfies(root, count)
    ids = json.loads((root / "dataset.json").read_text())["ids"]
    split = {"ids": ids, "train_ids": ids[::2], "val_ids": ids[1::2], "count": count, "num_exemplars": len(ids[::2])}
    (root / "dataset.json").write_text(json.dumps(split))
    return root


@pytest.mark.parametrize("frames", [30, 20, 15, 10])
def test_few_frames_are_spread_over_training_and_test_alike(tmp_path: Path, frames: int) -> None:
    scene, _ = read(alternating(tmp_path), frames=frames)
    assert abs(len(scene.train) - frames / 2) <= 1 and abs(len(scene.test) - frames / 2) <= 1

    def longest_gap(views: tuple[View, ...]) -> float:
        return float(np.diff([0.0, *(view.time for view in views), 87.0]).max())  # frames are at 0, 3, 6, … 87

    # A stretch of two times the mean distance: rounding to frames that there are, and the held-out ends.
    assert longest_gap(scene.train) <= 2 * 87 / (len(scene.train) - 1)
    assert longest_gap(scene.test) <= 2 * 87 / (len(scene.test) - 1)


def test_names_that_are_seconds_are_times(tmp_path: Path) -> None:
    write_nerfstudio(tmp_path)
    times = 1305031102 + np.arange(12) / 30 + np.random.default_rng(0).uniform(-2e-3, 2e-3, 12)

    def stamp(index: int, frame: dict) -> None:
        frame["file_path"] = f"images/{times[index]:.6f}.png"

    rewritten(tmp_path, stamp)
    scene, _ = read(tmp_path)
    views = sorted(scene.train + scene.test, key=lambda view: view.time)
    np.testing.assert_allclose([view.time for view in views], times, rtol=0, atol=1e-6)  # as many decimals as the names


@pytest.mark.parametrize(
    "dropped, held_out",
    [([2], "camera 0 (cam0)"), ([0], "camera 1 (cam1)"), ([0, 3], "every 8th frame")],  # of two cameras none is
)
def test_a_camera_that_is_dropped_is_not_read(tmp_path: Path, dropped: list[int], held_out: str) -> None:
    """The first view of camera c is the layout's c-th image."""
    whole, _ = read(rig(tmp_path, 0))
    places = {view.name[-10:]: view.camera.world_to_cam.tobytes() for view in (*whole.train, *whole.test)}
    scene, _ = read(tmp_path, drop_cameras=dropped)
    found = [view.camera.world_to_cam.tobytes() for view in (*scene.train, *scene.test)]
    kept = {places[f"{camera:05d}_0000"] for camera in range(4) if camera not in dropped}
    assert scene.test_split == held_out and set(found) == kept and len(found) == 8 * len(kept)


@pytest.mark.parametrize("dropped", [[4], [0, 1, 2, 3]])
def test_a_camera_that_is_not_there_or_all_cannot_be_dropped(tmp_path: Path, dropped: list[int]) -> None:
    names = r"0 \(cam0\), 1 \(cam1\), 2 \(cam2\), 3 \(cam3\)"
    with pytest.raises(SceneError, match=rf"scene\.drop_cameras: expected some of the cameras {names}, found"):
        read(rig(tmp_path, 0), drop_cameras=dropped)
