"""The bullet-time path: a closed curve among the training cameras that looks at their focus."""

from __future__ import annotations

import numpy as np
import pytest

from datasets.canonical import intersect_axes
from pipeline.evaluation.pictures.camera_path import (
    FRAME_RATE,
    SECONDS,
    bullet_time,
    ellipse_among,
    look_at,
    median_depth,
)
from rasterizer import Camera

DOWN = np.array([0.0, 1.0, 0.0])
EXACT = 1e-9  # float64 through one 3 × 3 solve


def camera(position: np.ndarray, target: np.ndarray, down: np.ndarray = DOWN) -> Camera:
    return Camera(64, 48, 60.0, 60.0, 32.0, 24.0, look_at(np.asarray(position, float), np.asarray(target, float), down))


def grid(target: np.ndarray = (0.0, 0.0, 5.0), shift: np.ndarray = (0.0, 0.0, 0.0)) -> list[Camera]:
    """5 × 3 cameras on the plane z = 0, 0.5 apart, that look at one point."""
    return [
        camera(np.array([x, y, 0.0]) + shift, np.array(target) + shift)
        for x in (-1, -0.5, 0, 0.5, 1)
        for y in (-0.5, 0, 0.5)
    ]


def ring(count: int = 12, outwards: bool = False) -> list[Camera]:
    """Cameras on a circle of radius 3 around the origin, looking at it or away from it."""
    at = [3 * np.array([np.cos(a), 0, np.sin(a)]) for a in np.linspace(0, 2 * np.pi, count, endpoint=False)]
    return [camera(p, 2 * p if outwards else 0 * p) for p in at]


def transformed(cameras: list[Camera]) -> tuple[list[Camera], np.ndarray]:
    """The same rig after a rigid transform of the world, and that (4, 4) transform."""
    q, r = np.linalg.qr(np.random.default_rng(3).standard_normal((3, 3)))
    q = q * np.sign(np.diag(r))
    world = np.eye(4)
    world[:3, :3], world[:3, 3] = q * np.linalg.det(q), (7, -2, 1)
    return [Camera(64, 48, 60.0, 60.0, 32.0, 24.0, c.world_to_cam @ np.linalg.inv(world)) for c in cameras], world


def path_of(cameras: list[Camera]):
    return bullet_time(ellipse_among(cameras, default_depth=4.0), cameras[0], 2.0, 8.0)


@pytest.mark.parametrize("cameras, focus", [(grid(), (0, 0, 5)), (ring(), (0, 0, 0))])
def test_poses_are_rotations_looking_at_the_focus(cameras: list[Camera], focus: tuple) -> None:
    for frame in path_of(cameras):
        rotation = frame.camera.world_to_cam[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=EXACT)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        x, y, z = rotation @ focus + frame.camera.world_to_cam[:3, 3]
        assert z > 0 and abs(x) < EXACT and abs(y) < EXACT
        assert rotation[1] @ DOWN > 0.9  # the image is not upside down


@pytest.mark.parametrize("cameras", [grid(), ring()])
def test_the_path_is_closed_and_without_jumps(cameras: list[Camera]) -> None:
    positions = np.stack([frame.camera.position for frame in path_of(cameras)])
    steps = np.linalg.norm(np.diff(positions, axis=0, append=positions[:1]), axis=1)
    assert len(positions) == SECONDS * FRAME_RATE
    # The largest step of an ellipse is at most its larger half axis × the step of the angle.
    spread = max(np.linalg.norm(c.position - positions.mean(axis=0)) for c in cameras)
    assert steps.max() <= spread * 2 * np.pi / (len(positions) / 2) and steps.min() > 0
    half = len(positions) // 2
    np.testing.assert_allclose(positions[:half], positions[half:], atol=EXACT)  # the second turn repeats the first


def test_the_path_stays_among_the_cameras() -> None:
    positions = np.stack([frame.camera.position for frame in path_of(grid())])
    assert np.abs(positions[:, 0]).max() <= 1 and np.abs(positions[:, 1]).max() <= 0.5
    # The 0.7 quantiles of the distances from the centre are 1 and 0.5, the maxima.
    assert np.abs(positions).max(axis=0) == pytest.approx([1.0, 0.5, 0.0], abs=2e-3)  # 75 points of the ellipse
    around = np.stack([frame.camera.position for frame in path_of(ring())])
    distance = np.linalg.norm(around, axis=1)
    assert distance.min() > 2 and distance.max() <= 3 and np.abs(around[:, 1]).max() < EXACT


def test_time_stands_in_the_first_turn_and_runs_in_the_second() -> None:
    times = [frame.time for frame in path_of(grid())]
    half = len(times) // 2
    assert set(times[:half]) == {6.0}  # the middle of [2, 10]
    assert times[half] == 6.0
    np.testing.assert_allclose(sorted(times[half:]), 2 + 8 * np.arange(half) / half, atol=0.06)  # half a step
    assert np.sum(np.diff(times[half:]) < 0) == 1  # the only discontinuity, from the end to the start


def test_the_path_is_equivariant_to_rigid_transforms() -> None:
    cameras, world = transformed(grid())
    for here, there in zip(path_of(grid()), path_of(cameras)):
        np.testing.assert_allclose(there.camera.world_to_cam @ world, here.camera.world_to_cam, atol=1e-8)


def test_parallel_cameras_have_their_focus_at_the_default_depth() -> None:
    parallel = [camera((x, 0, 0), (x, 0, 1)) for x in (-1.0, 0.0, 1.0)]
    assert intersect_axes(*_rays(parallel)) is None
    np.testing.assert_allclose(ellipse_among(parallel, default_depth=4.0).focus, (0, 0, 4), atol=EXACT)


def test_outward_looking_cameras_have_no_intersection() -> None:
    assert intersect_axes(*_rays(ring(outwards=True))) is None
    assert np.isfinite(ellipse_among(ring(outwards=True), default_depth=4.0).pose(1.0)).all()


def test_the_intersection_of_axes_minimises_the_squared_distances() -> None:
    """Skew axes: no point near the solution has a smaller sum."""
    rng = np.random.default_rng(0)
    cameras = [camera(c.position, np.array([0, 0, 5]) + 0.3 * rng.standard_normal(3)) for c in grid()]
    positions, directions = _rays(cameras)

    def squared(point: np.ndarray) -> float:
        off = np.cross(point - positions, directions)
        return float(np.sum(off**2))

    found = intersect_axes(positions, directions)
    assert all(squared(found) < squared(found + 1e-3 * step) for step in rng.standard_normal((50, 3)))


def test_with_one_camera_the_path_is_its_pose() -> None:
    frames = path_of([camera((0, 0, 0), (0, 0, 1))])
    np.testing.assert_allclose(
        np.stack([frame.camera.world_to_cam for frame in frames]), [np.eye(4)] * len(frames), atol=EXACT
    )


def test_the_path_does_not_depend_on_the_number_of_frames_per_camera() -> None:
    once, often = ellipse_among(grid(), 1.0), ellipse_among(grid() + [grid()[0]] * 100, 1.0)
    np.testing.assert_array_equal(once.centre, often.centre)
    np.testing.assert_array_equal(once.focus, often.focus)


def test_median_depth_is_of_visible_points() -> None:
    points = np.array([[0, 0, 2.0], [0.1, 0, 3.0], [0, 0.1, 7.0], [50, 0, 1.0], [0, 0, -1.0], [0, -40, 1.0]])
    assert median_depth(points, camera((0, 0, 0), (0, 0, 1))) == 3.0
    assert median_depth(points, camera((0, 0, 9), (0, 0, 10))) is None


def _rays(cameras: list[Camera]) -> tuple[np.ndarray, np.ndarray]:
    return np.stack([c.position for c in cameras]), np.stack([c.world_to_cam[2, :3] for c in cameras])
