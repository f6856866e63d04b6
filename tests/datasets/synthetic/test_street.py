"""synthetic/street through the real readers: LiDAR, masks and ground truth agree with each other in both layouts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from kitti_format import write_kitti_format

from datasets.scene import Scene
from datasets.settings import SceneConfig
from datasets.source import open_source
from datasets.synthetic import build_scene, drive
from datasets.urban.moving import moving_mask, moving_points
from datasets.urban.projection import depth_image, in_image, project
from datasets.urban.sky import estimate_sky

SIZE, FRAMES = 72, 4


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


def street(cache: Path, **changes: object) -> Scene:
    common = {"reader": "synthetic", "downscale": 1, "size": SIZE, "frames": FRAMES, "test_every": FRAMES}
    cfg = SceneConfig(name="synthetic/street", cache=str(cache), **{**common, **changes})
    return open_source(cfg, log=lambda line: None).scene()


@pytest.fixture(scope="module")
def scene(cache: Path) -> Scene:
    return street(cache)


def test_both_layouts_give_the_same_scene(tmp_path: Path, scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Images, masks and truth exactly; cameras and points to rounding (the files hold 17 digits, float32 points)."""
    monkeypatch.setattr(drive, "write_processed", write_kitti_format)
    other = street(tmp_path)
    assert len(scene.train) == 3 * (FRAMES - 1) and len(scene.test) == 3
    for a, b in zip(scene.train + scene.test, other.train + other.test):
        assert a.name == b.name and a.time == b.time and (np.asarray(a.image) == np.asarray(b.image)).all()
        assert (a.sky == b.sky).all()
        np.testing.assert_allclose(a.camera.world_to_cam, b.camera.world_to_cam, atol=1e-9)
        one, two = a.truth.read(), b.truth.read()
        assert (one.depth == two.depth).all() and (one.moving == two.moving).all()
    for a, b in zip(scene.sweeps, other.sweeps):
        np.testing.assert_allclose(a.points, b.points, atol=1e-4)


def test_lidar_measures_the_true_depth(scene: Scene) -> None:
    """The depth of a point and that at the pixel's centre differ by noise (2 cm) and by what half a pixel shows: on the
    road 10 m ahead, at 77 px of focal length and 1.6 m of height, 10² / (77 · 1.6) · ¼ = 0.2 m, 2 %."""
    for view in scene.train:
        sweep = next(sweep for sweep in scene.sweeps if sweep.frame == view.frame)
        truth, measured = view.truth.read().depth, depth_image(sweep.points, view.camera)
        known = (measured > 0) & (truth > 0)
        error = np.abs(measured[known] / truth[known] - 1)
        assert known.sum() > 1000 and np.median(error) < 0.01 and (error < 0.05).mean() > 0.85
        assert not ((measured > 0) & view.sky).any() or ((measured > 0) & view.sky).mean() < 0.005  # at edges


def test_hidden_points_are_removed(scene: Scene) -> None:
    """Points whose pixel truly shows something 20 % nearer: the filter removes most of them where there are any."""
    before, after = [], []
    for view in scene.train + scene.test:
        sweep = next(s for s in scene.sweeps + scene.test_sweeps if s.frame == view.frame)
        truth = view.truth.read().depth
        column, row, depth = project(sweep.points, view.camera)
        inside = in_image(column, row, depth, view.camera)
        shown = truth[row[inside].astype(int), column[inside].astype(int)]
        before.append(np.mean((shown > 0) & (depth[inside] > 1.2 * shown)))
        kept = depth_image(sweep.points, view.camera)
        after.append(np.mean((kept > 1.2 * truth)[(kept > 0) & (truth > 0)]))
    assert np.mean(after) < np.mean(before)


def test_sky_and_what_moves(scene: Scene) -> None:
    """Masks of the data are those of the truth; the estimated sky is nearly all right, and holds most of it."""
    shares = []
    for view in scene.train:
        truth = view.truth.read()
        assert (view.sky == (truth.depth == 0)).all() and (view.moving == truth.moving).all()
        sweep = next(sweep for sweep in scene.sweeps if sweep.frame == view.frame)
        found = estimate_sky(np.asarray(view.image), depth_image(sweep.points, view.camera))
        if view.sky.mean() > 0.02:
            shares.append(((found & view.sky).sum() / max(1, found.sum()), (found & view.sky).sum() / view.sky.sum()))
    precision, recall = np.mean(shares, axis=0)
    assert precision > 0.98 and recall > 0.7


def test_flow_follows_what_moves(scene: Scene) -> None:
    """Of a still body seen by the same camera later there is none; of the car ahead it is as far as it drives."""
    front = next(view for view in scene.train if view.name.startswith("train/cam0"))
    truth = front.truth.read()
    assert truth.flow_dt == pytest.approx(0.1)
    still = ~truth.moving & truth.flow_valid
    assert np.abs(truth.flow[:, still]).max() < 0.02 < np.abs(truth.flow[:, truth.moving]).max()


def test_the_same_arguments_give_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drive, "STEPS", 40)
    for name in ("one", "other"):
        build_scene(tmp_path / name, scene="street", seed=3, size=24, frames=2)
    files = sorted(path.relative_to(tmp_path / "one") for path in (tmp_path / "one").rglob("*") if path.is_file())
    assert len(files) > 20
    for file in files:
        if file.suffix != ".npz":  # whose archive holds the time of writing
            assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "other" / file).read_bytes()


def test_points_of_moving_bodies_are_a_mask_of_them(scene: Scene) -> None:
    """With what truly moves among the points, the mask of convex hulls covers what the LiDAR sees of it."""
    view = next(view for view in scene.train if view.name.startswith("train/cam0"))
    sweep = next(sweep for sweep in scene.sweeps if sweep.frame == view.frame)
    column, row, depth = project(sweep.points, view.camera)
    inside = in_image(column, row, depth, view.camera)
    truly = np.zeros(len(inside), bool)
    truly[inside] = view.truth.read().moving[row[inside].astype(int), column[inside].astype(int)]
    mask, truth = moving_mask(sweep.points[truly], view.camera), view.truth.read().moving
    assert (mask & truth).sum() > 0.8 * truth.sum()
    assert not moving_points(sweep, []).any()  # without other sweeps nothing is known to move
