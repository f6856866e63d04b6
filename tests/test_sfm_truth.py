"""Structure from motion where the truth is known: cameras and depths of the synthetic counter."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from datasets.plenoptic import Posed, open_plenoptic
from datasets.scene import camera_extent
from datasets.synthetic import build_scene
from pipeline.config import InitConfig
from pipeline.prepare import training_photographs
from pipeline.sfm.photograph import Photograph, Reconstruction
from pipeline.sfm.run import reconstruct
from rasterizer import Camera

CAMERAS, SIZE = 6, 320
CFG = InitConfig(max_features=3000)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("counter") / "scene"
    return build_scene(folder, scene="counter", seed=1, size=SIZE, cameras=CAMERAS, frames=1)


@pytest.fixture(scope="module")
def posed(folder: Path) -> Posed:
    return open_plenoptic(folder, name="counter", downscale=1, cache=folder.parent / "cache")


@pytest.fixture(scope="module")
def found(posed: Posed, folder: Path) -> Reconstruction:
    return reconstruct(training_photographs(posed), CFG, posed.unit, folder)


def test_the_photographs_are_the_training_cameras_at_the_first_moment(posed: Posed) -> None:
    photographs = training_photographs(posed)
    assert [p.name for p in photographs] == [f"cam{i:02d}" for i in range(1, CAMERAS)]  # cam00 is held out
    for photograph in photographs:
        np.testing.assert_array_equal(photograph.image, posed.first_images()[photograph.name])
        assert photograph.camera is posed.cameras[photograph.name]


def test_points_lie_on_the_surfaces(found: Reconstruction, folder: Path, posed: Posed) -> None:
    """Each point lies beside a surface: its depth in a camera that sees it is the tracer's there.

    A point behind something is not seen by that camera, so of all cameras the best one counts.
    """
    off = np.full(len(found.points), np.inf)
    for name, lens in found.lenses.items():
        depth = np.load(folder / "truth" / f"{name}_depth.npy")
        seen = found.points @ lens.camera.world_to_cam[:3, :3].T + lens.camera.world_to_cam[:3, 3]
        x, y = (seen[:, i] / seen[:, 2] * (lens.camera.fx, lens.camera.fy)[i] + (lens.camera.cx, lens.camera.cy)[i]
                for i in (0, 1))
        inside = np.flatnonzero((seen[:, 2] > 0) & (x >= 0) & (x < depth.shape[1]) & (y >= 0) & (y < depth.shape[0]))
        truth = depth[y[inside].astype(int), x[inside].astype(int)]
        off[inside] = np.minimum(off[inside], np.abs(seen[inside, 2] - truth))
    assert len(off) > 300 and np.isfinite(off).all()
    assert np.median(off) < 0.01 * camera_extent(list(posed.cameras.values()))


def test_poses_estimated_from_nothing_are_the_true_ones_up_to_a_similarity(posed: Posed, folder: Path) -> None:
    photographs = [Photograph(name, image, held_out=name == "cam00") for name, image in posed.first_images().items()]
    found = reconstruct(photographs, CFG, 1.0, folder)
    truth = {name: camera.position for name, camera in posed.cameras.items()}
    ours = np.stack([found.lenses[name].camera.position for name in truth])
    # Half a per cent of the rig's width: a pixel's depth error at this size and baseline is about one per cent.
    assert distances_after_similarity(ours, np.stack(list(truth.values()))).max() < 0.02


def test_refined_poses_come_nearer_to_the_truth_and_stay_in_its_frame(posed: Posed, folder: Path) -> None:
    rng = np.random.default_rng(0)
    photographs = training_photographs(posed)
    true = {p.name: p.camera for p in photographs}
    before = {name: shaken(camera, 0.01, rng) for name, camera in true.items()}
    moved = [replace(p, camera=before[p.name]) for p in photographs]
    found = reconstruct(moved, replace(CFG, refine_poses=True, max_error_px=4.0), posed.unit, folder)
    after = {name: lens.camera for name, lens in found.lenses.items()}
    assert found.poses == "refined"

    def bend(cameras: dict[str, Camera]) -> float:
        """Distances between cameras against the true ones: what shaking changes and no choice of frame does."""
        ours, truth = (np.stack([c[name].position for name in true]) for c in (cameras, true))
        return float(np.sqrt(np.mean(distances_after_similarity(ours, truth) ** 2)))

    assert bend(after) < 0.6 * bend(before)
    # The frame is that of the poses given: it moves no further than they were shaken.
    shift = np.mean([after[name].position - before[name].position for name in true], axis=0)
    assert np.linalg.norm(shift) < 1e-6


def shaken(camera: Camera, amount: float, rng: np.random.Generator) -> Camera:
    pose = camera.world_to_cam.copy()
    pose[:3, 3] += amount * rng.normal(size=3)
    return replace(camera, world_to_cam=pose)


def distances_after_similarity(points: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(N,) what is left between point sets (N, 3) after the best rotation, scale and shift (Umeyama 1991), relative to
    the target's spread."""
    a, b = points - points.mean(axis=0), target - target.mean(axis=0)
    u, s, vt = np.linalg.svd(b.T @ a)
    sign = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    scale = np.trace(np.diag(s) @ sign) / (a**2).sum()
    spread = np.sqrt((b**2).sum(axis=1).max())
    return np.linalg.norm(scale * a @ (u @ sign @ vt).T - b, axis=1) / spread
