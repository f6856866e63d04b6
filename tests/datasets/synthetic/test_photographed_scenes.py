"""Photographed synthetic scenes: camera poses, round trip through the disk, determinism, cache, command line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import dnerf_folder
import numpy as np
import pytest

from datasets.files.errors import SceneError
from datasets.ground_truth import StoredTruth
from datasets.settings import SceneConfig
from datasets.source import open_source
from datasets.synthetic import PHOTOGRAPHED, build_scene, make_scene
from datasets.synthetic.__main__ import main
from datasets.synthetic.camera_path import TimedPose, arc_poses, held_out_poses, poses_beside_camera, training_poses
from datasets.synthetic.trace import TracedImage, trace
from datasets.synthetic.write import to_rgba
from fuzz.target import read_files
from rasterizer.camera import Camera

# --- cameras ----------------------------------------------------------------------------------------------------------


def test_cameras_on_the_upper_hemisphere_look_at_the_origin() -> None:
    for pose in training_poses(20, np.random.default_rng(0)):
        camera = Camera.from_blender(40, 40, 55.0, pose.cam_to_world)
        assert np.linalg.norm(camera.position) == pytest.approx(4.0) and camera.position[2] > 0
        np.testing.assert_allclose((camera.world_to_cam @ [0, 0, 0, 1])[:3], [0, 0, 4], atol=1e-9)
        up = camera.world_to_cam[:3, :3] @ [0, 0, 1]
        assert abs(up[0]) < 1e-9 and up[1] < 0  # y points down


@pytest.mark.parametrize(("train", "test"), [(60, 12), (100, 12), (2, 1), (5, 9)])
def test_held_out_times_lie_between_training_times(train: int, test: int) -> None:
    rng = np.random.default_rng(0)
    trained = np.array([pose.time for pose in training_poses(train, rng)])
    held_out = np.array([pose.time for pose in held_out_poses(test, train, rng)])
    np.testing.assert_allclose(trained, np.arange(train) / (train - 1))
    gap = 1 / (train - 1)
    nearest = np.abs(held_out[:, None] - trained).min(axis=1)
    np.testing.assert_allclose(nearest, gap / 2, atol=1e-12)
    assert held_out.min() > 0 and held_out.max() < 1


def test_an_arc_is_filmed_by_one_camera_and_tested_beside_it() -> None:
    start = 0.7
    train, test = arc_poses(50, start), poses_beside_camera(8, 50, start)

    def place(pose: TimedPose) -> np.ndarray:
        return pose.cam_to_world[:3, 3] / 4.0  # on the unit sphere

    steps = [np.degrees(np.arccos(place(a) @ place(b))) for a, b in zip(train, train[1:])]
    assert min(steps) > 0.5 and max(steps) < 2.5, "about 80 degrees in 49 steps"
    for number, pose in enumerate(test):
        before = max(i for i, other in enumerate(train) if other.time < pose.time)
        on_path = place(train[before]) + place(train[before + 1])
        away = np.degrees(np.arccos(place(pose) @ on_path / np.linalg.norm(on_path)))
        # Azimuth is foreshortened by the elevation, 21 to 30 degrees; above and below is half as far.
        low, high = (12, 15) if number % 4 < 2 else (7, 8)
        assert low < away < high
    on_arc = poses_beside_camera(8, 50, start, aside=0.0)
    assert [pose.time for pose in on_arc] == [pose.time for pose in test]
    assert min(np.linalg.norm(place(pose) - place(other)) for pose in on_arc for other in train) < 0.02


@pytest.mark.parametrize(("name", "is_clip"), [("wheel", True), ("still", False)])
def test_a_scene_filmed_along_an_arc_is_a_clip(name: str, is_clip: bool, tmp_path: Path) -> None:
    settings = SceneConfig(f"synthetic/{name}", "synthetic", downscale=1, cache=str(tmp_path), **SMALL)
    assert open_source(settings).scene().capture == ("monocular" if is_clip else "static")
    assert open_source(replace(settings, camera_path="arc")).scene().capture == ("clip" if is_clip else "static")


def test_a_scene_with_cameras_of_its_own_is_not_filmed_along_an_arc(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"^scene\.camera_path: expected jumps for counter; .*, found arc$"):
        make_scene("counter", tmp_path, camera_path="arc")


# --- on disk ----------------------------------------------------------------------------------------------------------

SMALL = {"size": 24, "train_views": 3, "test_views": 2}


@pytest.mark.parametrize("name", PHOTOGRAPHED)
def test_round_trip_of_traced_images(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    originals: list[TracedImage] = []

    def keep(*arguments: object, **options: object) -> TracedImage:
        originals.append(trace(*arguments, **options))
        return originals[-1]

    monkeypatch.setattr("datasets.synthetic.write.trace", keep)
    folder = build_scene(tmp_path / name, scene=name, seed=0, **SMALL)
    for background in ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)):
        scene = dnerf_folder.read(folder, downscale=1, background=background)
        traced = [*originals[:3], *originals[-2:]]  # written as train, val, test
        for view, truth in zip(scene.train + scene.test, traced, strict=True):
            expected = 255 * (truth.color + (1 - truth.alpha) * background[0])
            # Rounding of alpha (½ through the background), of colour (½) and of the composed image (½).
            worst = 1.0 if background[0] == 0 else 1.5
            np.testing.assert_allclose(view.image.transpose(2, 0, 1), expected, atol=worst + 1e-3)
    assert (scene.capture == "static") == (name == "still")
    times = [
        "time" in frame
        for split in ("train", "val", "test")
        for frame in json.loads((folder / f"transforms_{split}.json").read_text())["frames"]
    ]
    assert times == [name != "still"] * 6
    for view, truth in zip(scene.test, originals[-2:]):
        assert view.truth is not None
        stored = view.truth.read()
        for array in ("depth", "flow", "flow_valid"):
            np.testing.assert_array_equal(getattr(stored, array), getattr(truth, array))


@pytest.mark.parametrize("name", PHOTOGRAPHED)
def test_surfaces_lie_in_the_box_of_random_points(name: str, tmp_path: Path) -> None:
    folder = build_scene(tmp_path / name, scene=name, seed=1, size=24, train_views=3, test_views=8)
    corner = np.zeros(3)
    for view in dnerf_folder.read(folder, downscale=1).test:
        depth, camera = StoredTruth(folder / f"{view.name}.npz").read().depth, view.camera
        assert depth is not None
        rows, columns = np.nonzero(depth)
        pixels = np.stack(
            [(columns + 0.5 - camera.cx) / camera.fx, (rows + 0.5 - camera.cy) / camera.fy, np.ones(len(rows))]
        )
        points = camera.world_to_cam[:3, :3].T @ (pixels * depth[rows, columns]) + camera.position[:, None]
        corner = np.maximum(corner, np.abs(points).max(axis=1))
    assert (corner <= 1.2).all() and (corner > 0.4).all()


def test_bytes_depend_on_the_seed(tmp_path: Path) -> None:
    first, again, other = (
        read_files(build_scene(tmp_path / str(number), scene="burst", seed=seed, **SMALL))
        for number, seed in enumerate((5, 5, 6))
    )
    assert first == again
    assert first.keys() == other.keys() and first["train/r_0.png"] != other["train/r_0.png"]


def test_make_scene_uses_the_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = make_scene("still", tmp_path, **SMALL)
    monkeypatch.setattr("datasets.synthetic.build_scene", lambda *_, **__: pytest.fail("made again"))
    assert make_scene("still", tmp_path, **SMALL) == folder
    assert [path.name for path in tmp_path.iterdir()] == [folder.name]


@pytest.mark.parametrize("left", [None, "scenes: {still: {files: [meta.json]}}"], ids=["killed", "an earlier form"])
def test_a_manifest_that_cannot_be_read_is_written_again(tmp_path: Path, left: str | None) -> None:
    manifest = make_scene("still", tmp_path, **SMALL) / "manifest.yaml"
    whole = manifest.read_bytes()
    manifest.unlink()
    if left is not None:
        manifest.write_text(left)
    make_scene("still", tmp_path, **SMALL)
    assert manifest.read_bytes() == whole


def test_cache_folder_depends_on_arguments(tmp_path: Path) -> None:
    folders = {
        make_scene("still", tmp_path, **{**SMALL, **change})
        for change in ({}, {"seed": 1}, {"size": 16}, {"train_views": 2}, {"test_views": 1})
    }
    assert len(folders) == 5


def test_an_exception_leaves_no_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("datasets.synthetic.write.trace", lambda *_, **__: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        make_scene("still", tmp_path, **SMALL)
    assert list(tmp_path.iterdir()) == []


def test_existing_folder_is_kept(tmp_path: Path) -> None:
    folder = build_scene(tmp_path / "scene", scene="still", seed=0, **SMALL)
    before = read_files(folder)
    build_scene(folder, scene="still", seed=0, **SMALL)
    assert read_files(folder) == before and [path.name for path in tmp_path.iterdir()] == ["scene"]


def test_to_rgba_has_straight_alpha() -> None:
    empty = np.zeros((1, 3), dtype=np.float32)
    alpha = np.array([[0.0, 4 / 9, 1.0]], dtype=np.float32)
    color = np.stack([alpha * 0.5] * 3)
    rgba = to_rgba(TracedImage(color, alpha, empty, np.stack([empty] * 2), empty > 0, empty.astype(np.int16)))
    assert rgba[0, 0].tolist() == [0, 0, 0, 0] and rgba[0, 2].tolist() == [128, 128, 128, 255]
    assert rgba[0, 1, 3] == 113 and abs(int(rgba[0, 1, 0]) - 128) <= 1  # straight, not premultiplied


def test_scene_by_config(tmp_path: Path) -> None:
    cfg = SceneConfig(name="synthetic/lamp", reader="synthetic", downscale=1, cache=str(tmp_path), **SMALL)
    scene = open_source(cfg).scene()
    assert (scene.name, len(scene.train), len(scene.test)) == ("synthetic/lamp", 3, 2)
    assert scene.train[0].image.shape == (24, 24, 3) and scene.source.parent == tmp_path


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"name": "synthetic/wheal"},
            "expected synthetic/ and one of wheel, lamp, burst, still, counter, street, found 'wheal'",
        ),
        ({"train_views": 1}, "expected at least 2 and 1, found 1 and 2"),
        ({"reader": "dnerf"}, r"scene.path: expected the folder of the data \(scene.path=DIR\), found none"),
    ],
)
def test_invalid_config_is_refused(changes: dict, message: str, tmp_path: Path) -> None:
    fields = {"name": "synthetic/lamp", "reader": "synthetic", "cache": str(tmp_path), **SMALL, **changes}
    with pytest.raises(SceneError, match=message):
        open_source(SceneConfig(**fields)).scene()
    assert list(tmp_path.iterdir()) == []


def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["still", "--out", str(tmp_path / "out"), "--size", "16", "--train-views", "2", "--test-views", "1"]
    assert main(options) == 0
    assert "2 training and 1 test views of 16 x 16 pixels" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(options)  # the folder is not empty
    assert "does not exist or is empty" in capsys.readouterr().err
