"""The bullet-time path: a closed curve among the cameras that looks at what they look at."""

from __future__ import annotations

import numpy as np
import pytest

from datasets.cameras.optical_axes import axes_meet
from pipeline.evaluation.camera_path import FRAME_RATE, SECONDS, bullet_time, ellipse_among, look_at, median_depth
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
    """On a circle of radius 3 around the origin, looking at it."""
    at = [3 * np.array([np.cos(a), 0, np.sin(a)]) for a in np.linspace(0, 2 * np.pi, count, endpoint=False)]
    return [camera(p, 2 * p if outwards else 0 * p) for p in at]


def rotated(cameras: list[Camera]) -> tuple[list[Camera], np.ndarray]:
    """The same rig turned and moved in the world; and the (4, 4) that did it."""
    q, r = np.linalg.qr(np.random.default_rng(3).standard_normal((3, 3)))
    q = q * np.sign(np.diag(r))
    world = np.eye(4)
    world[:3, :3], world[:3, 3] = q * np.linalg.det(q), (7, -2, 1)
    return [Camera(64, 48, 60.0, 60.0, 32.0, 24.0, c.world_to_cam @ np.linalg.inv(world)) for c in cameras], world


def shots_of(cameras: list[Camera]):
    return bullet_time(ellipse_among(cameras, usual_depth=4.0), cameras[0], 2.0, 8.0)


@pytest.mark.parametrize("cameras, focus", [(grid(), (0, 0, 5)), (ring(), (0, 0, 0))])
def test_poses_are_rotations_that_look_at_the_focus(cameras: list[Camera], focus: tuple) -> None:
    for shot in shots_of(cameras):
        rotation = shot.camera.world_to_cam[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=EXACT)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        x, y, z = rotation @ focus + shot.camera.world_to_cam[:3, 3]
        assert z > 0 and abs(x) < EXACT and abs(y) < EXACT
        assert rotation[1] @ DOWN > 0.9  # the image is not upside down


@pytest.mark.parametrize("cameras", [grid(), ring()])
def test_the_path_is_closed_and_even(cameras: list[Camera]) -> None:
    positions = np.stack([shot.camera.position for shot in shots_of(cameras)])
    steps = np.linalg.norm(np.diff(positions, axis=0, append=positions[:1]), axis=1)
    assert len(positions) == SECONDS * FRAME_RATE
    # An ellipse's largest step is at most its larger half axis × the step of the angle; no jump anywhere.
    spread = max(np.linalg.norm(c.position - positions.mean(axis=0)) for c in cameras)
    assert steps.max() <= spread * 2 * np.pi / (len(positions) / 2) and steps.min() > 0
    half = len(positions) // 2
    np.testing.assert_allclose(positions[:half], positions[half:], atol=EXACT)  # the second turn is the first again


def test_it_stays_among_the_cameras() -> None:
    positions = np.stack([shot.camera.position for shot in shots_of(grid())])
    assert np.abs(positions[:, 0]).max() <= 1 and np.abs(positions[:, 1]).max() <= 0.5
    # 7 of 10 cameras are at most 1 and 0.5 off the middle, as far as any.
    assert np.abs(positions).max(axis=0) == pytest.approx([1.0, 0.5, 0.0], abs=2e-3)  # 75 points of the ellipse
    around = np.stack([shot.camera.position for shot in shots_of(ring())])
    distance = np.linalg.norm(around, axis=1)
    assert distance.min() > 2 and distance.max() <= 3 and np.abs(around[:, 1]).max() < EXACT


def test_time_stands_still_and_then_runs_through_all_of_it() -> None:
    times = [shot.time for shot in shots_of(grid())]
    half = len(times) // 2
    assert set(times[:half]) == {6.0}  # the middle of [2, 10]
    assert times[half] == 6.0
    np.testing.assert_allclose(sorted(times[half:]), 2 + 8 * np.arange(half) / half, atol=0.06)  # half a step
    assert np.sum(np.diff(times[half:]) < 0) == 1  # the one jump, from the end to the start


def test_it_does_not_depend_on_where_the_world_is() -> None:
    cameras, world = rotated(grid())
    for here, there in zip(shots_of(grid()), shots_of(cameras)):
        np.testing.assert_allclose(there.camera.world_to_cam @ world, here.camera.world_to_cam, atol=1e-8)


def test_parallel_cameras_look_as_far_as_usual() -> None:
    parallel = [camera((x, 0, 0), (x, 0, 1)) for x in (-1.0, 0.0, 1.0)]
    assert axes_meet(*_rays(parallel)) is None
    np.testing.assert_allclose(ellipse_among(parallel, usual_depth=4.0).focus, (0, 0, 4), atol=EXACT)


def test_cameras_that_look_away_from_each_other_meet_nowhere() -> None:
    assert axes_meet(*_rays(ring(outwards=True))) is None
    assert np.isfinite(ellipse_among(ring(outwards=True), usual_depth=4.0).pose(1.0)).all()


def test_axes_meet_by_naive_search() -> None:
    """Axes that miss each other: no point near the found one is nearer to all."""
    generator = np.random.default_rng(0)
    cameras = [camera(c.position, np.array([0, 0, 5]) + 0.3 * generator.standard_normal(3)) for c in grid()]
    positions, directions = _rays(cameras)

    def squared(point: np.ndarray) -> float:
        off = np.cross(point - positions, directions)
        return float(np.sum(off**2))

    found = axes_meet(positions, directions)
    assert all(squared(found) < squared(found + 1e-3 * step) for step in generator.standard_normal((50, 3)))


def test_one_camera_is_no_path_but_a_view() -> None:
    shots = shots_of([camera((0, 0, 0), (0, 0, 1))])
    np.testing.assert_allclose(
        np.stack([shot.camera.world_to_cam for shot in shots]), [np.eye(4)] * len(shots), atol=EXACT
    )


def test_frames_of_one_camera_do_not_pull_the_path_to_it() -> None:
    once, often = ellipse_among(grid(), 1.0), ellipse_among(grid() + [grid()[0]] * 100, 1.0)
    np.testing.assert_array_equal(once.centre, often.centre)
    np.testing.assert_array_equal(once.focus, often.focus)


def test_median_depth_is_of_what_is_seen() -> None:
    points = np.array([[0, 0, 2.0], [0.1, 0, 3.0], [0, 0.1, 7.0], [50, 0, 1.0], [0, 0, -1.0], [0, -40, 1.0]])
    assert median_depth(points, camera((0, 0, 0), (0, 0, 1))) == 3.0
    assert median_depth(points, camera((0, 0, 9), (0, 0, 10))) is None


def _rays(cameras: list[Camera]) -> tuple[np.ndarray, np.ndarray]:
    return np.stack([c.position for c in cameras]), np.stack([c.world_to_cam[2, :3] for c in cameras])
