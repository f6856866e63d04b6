"""Initial points and depth targets of driving logs, on a wall with a LiDAR in front of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tiny import tiny_config

from datasets.canonical import DISTANCE, canonical_of, canonicalise
from datasets.scene import Scene, Sweep, View
from pipeline.data.depth_targets import DepthTargets
from pipeline.data.lidar.initial_points import coloured_points, far_points, highest_beam, initial_points, thinned
from pipeline.data.lidar.velocities import agreed, sweep_velocities
from pipeline.model.initialise import initialise, set_velocities
from pipeline.model.model import Model, ModelKind, kind_of
from rasterizer import Gradients, Rasterizer, Request
from rasterizer.camera import Camera
from rasterizer.reference.render import slice_in_time

WIDTH, HEIGHT, FOCAL, WALL = 24, 16, 20.0, 30.0
RED, BLUE = (200, 30, 20), (20, 30, 200)


def drive(frames: int = 4, sky_rows: int = 3) -> Scene:
    """A car that drives towards a wall at z = WALL, red on its left half, and sees its lower half by LiDAR."""
    views, sweeps = [], []
    across, down = np.meshgrid(np.linspace(-8, 8, 60), np.linspace(0.2, 6, 20))
    wall = np.stack([across.ravel(), down.ravel(), np.full(across.size, WALL)], axis=1)
    for frame in range(frames):
        pose = np.eye(4)
        pose[2, 3] = -2.0 * frame
        camera = Camera(WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, pose)
        image = np.empty((HEIGHT, WIDTH, 3), np.uint8)
        image[:, : WIDTH // 2], image[:, WIDTH // 2 :] = RED, BLUE
        sky = np.zeros((HEIGHT, WIDTH), bool)
        sky[:sky_rows] = True
        views.append(View(camera, 0.1 * frame, image, f"train/cam2_{frame:06d}", frame=frame, sky=sky))
        sweeps.append(Sweep(frame, 0.1 * frame, np.array([0, -1.0, 2.0 * frame]), wall))
    return Scene(
        "drive", tuple(views), tuple(views[-1:]), 0.3, 0.0, (0.0, 0.0, 0.0), 5.0, (-30.0, 30.0), Path("drive"), "drive",
        unit=5.0, sweeps=tuple(sweeps), metre=1.0,
    )  # fmt: skip


def test_points_have_the_colour_and_time_of_the_image_that_sees_them() -> None:
    found = coloured_points(drive(), np.random.default_rng(0))
    left = found.points[:, 0] < -0.5
    assert (found.colors[left] == RED).all() and (found.colors[found.points[:, 0] > 0.5] == BLUE).all()
    assert set(np.round(found.times, 6)) == {0.0, 0.1, 0.2, 0.3}


def test_thinning_keeps_a_point_of_each_voxel_within_the_budget() -> None:
    """And nearly uses the budget; each kept point is one of the originals, at its own time."""
    cloud = coloured_points(drive(), np.random.default_rng(0))
    kept = thinned(cloud, 200, np.random.default_rng(1))
    assert 150 <= len(kept.points) <= 200
    originals = {(*point, time) for point, time in zip(cloud.points.tolist(), cloud.times.tolist())}
    assert all((*point, time) in originals for point, time in zip(kept.points.tolist(), kept.times.tolist()))
    again = thinned(cloud, 200, np.random.default_rng(1))
    assert (again.points == kept.points).all()
    assert len(thinned(cloud, 10**6, np.random.default_rng(1)).points) == len(cloud.points)


def test_far_points_lie_above_the_beams_and_below_the_sky() -> None:
    """At about the depth of the wall below them, in the image's colour."""
    scene = drive()
    found = far_points(scene, 300, np.random.default_rng(2))
    assert len(found.points) == 300
    for point, time, color in zip(found.points, found.times, found.colors):
        view = min(scene.train, key=lambda v: abs(v.time - time))
        x, y, z = view.camera.world_to_cam[:3, :3] @ point + view.camera.world_to_cam[:3, 3]
        column, row = FOCAL * x / z + WIDTH / 2, FOCAL * y / z + HEIGHT / 2
        assert 3 <= row < 9 and (color == (RED if column < WIDTH / 2 else BLUE)).all()
        assert 0.5 < z / (WALL - 20 * time) < 2.0  # 7 standard deviations of a tenth


def test_the_highest_beam_of_a_column_without_any_is_the_nearest_columns() -> None:
    depth = np.zeros((4, 5), np.float32)
    depth[2:, 1] = 7.0
    depth[3, 4] = 9.0
    top, at = highest_beam(depth)
    assert top.tolist() == [2, 2, 2, 3, 3] and at.tolist() == [7, 7, 7, 9, 9]
    assert highest_beam(np.zeros((4, 2)))[0].tolist() == [4, 4]


def rendered_with(model: Model, scene: Scene) -> tuple[int, int]:
    """SH degree and Fourier order that the kernel renders a training view with, backward too."""
    view, rasterizer, gaussians = scene.train[0], Rasterizer(threads=1), model.gaussians()
    rendered = rasterizer.render(gaussians, Request(view.camera, view.time, scene.duration, scene.background))
    gradients = Gradients.zeros_like(gaussians)
    rasterizer.backward(gradients, d_color=torch.ones_like(rendered.color))
    (colors,) = gradients.views
    assert len(colors.visible) > 0
    return colors.sh_degree, colors.fourier_order


def test_a_model_starts_from_the_sweeps_and_has_no_fourier_orders() -> None:
    """What a log does not need is not there: 16 coefficients, as many points as asked for, no sphere."""
    scene = drive()
    cfg = tiny_config()
    cfg = replace(cfg, init=replace(cfg.init, lidar_points=150), ablation=replace(cfg.ablation, fourier_order=0))
    model = initialise(scene, cfg, np.random.default_rng(0))
    assert 100 <= len(model) <= 150 and model.kind == kind_of(scene, cfg) and model.sphere is None
    assert model.kind.fourier_order == 0 and model.parameters["sh"].shape[1] == 16
    expected = initial_points(scene, 150, np.random.default_rng(0))
    np.testing.assert_allclose(
        model.parameters["mean"].numpy(), np.column_stack([expected.points, expected.times]), 1e-6
    )
    # 65 float32 a Gaussian: mean 4, scale 4, rotations 8, opacity 1, colour 16 · 3.
    assert model.bytes == len(model) * 65 * 4 and rendered_with(model, scene) == (3, 0)
    random = initialise(scene, replace(cfg, init=replace(cfg.init, source="random")), np.random.default_rng(0))
    assert len(random) == cfg.train.init_points


def test_depth_targets_are_those_of_the_own_sweep_at_any_size() -> None:
    scene = drive()
    targets = DepthTargets(scene)
    for size in ((WIDTH, HEIGHT), (WIDTH // 2, HEIGHT // 2)):
        camera = scene.train[2].camera.resized(*size)
        found = targets.at(2, camera)
        np.testing.assert_allclose(1 / found.inverse.numpy(), WALL - 4.0, rtol=1e-5)
        rows = found.pixel.numpy() // camera.width
        assert rows.min() >= camera.height // 2
    assert DepthTargets(replace(scene, sweeps=())).at(2, scene.train[2].camera) is None


def test_a_drive_is_normalised_by_its_way() -> None:
    """The way's middle becomes the origin; a short way is not enlarged beyond 10 m a unit; sweeps move with cameras."""
    scene = drive()
    transform = canonical_of(scene)
    assert transform.centre == pytest.approx((0, 0, 3.0)) and transform.scale == pytest.approx(DISTANCE / 40)
    moved = canonicalise(scene, transform)
    np.testing.assert_allclose(moved.sweeps[1].points, (scene.sweeps[1].points - [0, 0, 3]) / 10)
    assert moved.metre == pytest.approx(0.1) and moved.sweeps[3].time == pytest.approx(1.0)
    one, other = (DepthTargets(s).at(1, s.train[1].camera) for s in (scene, moved))
    assert (one.pixel == other.pixel).all()
    np.testing.assert_allclose(other.inverse, 10 * one.inverse, rtol=1e-5)


def passing(frames: int = 9, speed: float = 12.0) -> Scene:
    """A box 15 m ahead that drives to the right before a wall, as LiDAR sees them, ten times a second."""
    across, down = np.meshgrid(np.arange(-12, 12, 0.1), np.arange(-2, 2, 0.1))
    wall = np.stack([across.ravel(), down.ravel(), np.full(across.size, 25.0)], axis=1)
    side, up = np.meshgrid(np.arange(-1, 1, 0.1), np.arange(-1, 1, 0.3))
    sweeps, views = [], []
    for frame in range(frames):
        middle = 0.1 * speed * (frame - 4)
        box = np.stack([middle + side.ravel(), up.ravel(), np.full(side.size, 15.0)], axis=1)
        hidden = (np.abs(wall[:, 0] - 25 / 15 * middle) < 1.75) & (np.abs(wall[:, 1]) < 1.75)
        sweeps.append(Sweep(frame, 0.1 * frame, np.zeros(3), np.concatenate([box, wall[~hidden]])))
        camera = Camera(60, 20, 40.0, 40.0, 30.0, 10.0, np.eye(4))
        image = np.full((20, 60, 3), 90, np.uint8)
        views.append(View(camera, 0.1 * frame, image, f"train/cam2_{frame:06d}", frame=frame))
    return replace(drive(), train=tuple(views), sweeps=tuple(sweeps), duration=0.8)


def test_velocities_are_those_of_the_box_and_of_nothing_else() -> None:
    """12 m/s to the right; of the wall none. In other units they scale. 5 %: the beams of a sweep are 0.1 m apart."""
    scene = passing()
    found = sweep_velocities(scene)
    box = scene.sweeps[4].points[:, 2] == 15.0
    np.testing.assert_allclose(np.median(found[4][box], axis=0), [12.0, 0.0, 0.0], atol=0.6)
    assert (found[4][~box] == 0).mean() > 0.98
    transform = canonical_of(scene)
    moved = sweep_velocities(canonicalise(scene, transform))
    np.testing.assert_allclose(moved[4], found[4] * transform.scale / transform.time_scale, atol=1e-9)


def test_velocities_that_disagree_are_not_taken() -> None:
    fast, slow = np.array([9.0, 0, 0]), np.array([5.0, 0, 0])
    assert (agreed([fast, fast + 0.5], 2.5) == fast + 0.25).all()
    for listed in ([fast, slow], [fast, None], [None, None], []):
        assert (agreed(listed, 2.5) == 0).all()
    assert (agreed([fast], 2.5) == fast).all()  # the first and the last sweep have one neighbour


@pytest.mark.parametrize("scale", [1e-3, 0.02, 0.5])
def test_gaussians_start_with_the_velocities(scale: float) -> None:
    """By the kernel's reference in float64: velocity, lifetime, and the spatial covariance at any time, which does not
    change. 1e-5, as the parameters are float32; 1e-6 was found."""
    model = Model(ModelKind("full", 0, 0), {
        name: torch.zeros(4, *row) for name, row in ModelKind("full", 0, 0).shapes().items()
    })  # fmt: skip
    model.parameters["quat_left"][:, 0] = model.parameters["quat_right"][:, 0] = 1
    model.parameters["log_scale"][:, :3], model.parameters["log_scale"][:, 3] = np.log(scale), np.log(0.25)
    velocities = np.array([[3.0, -2.0, 0.5], [0.0, 0.0, 0.0], [0.0, 0.0, -7.0], [0.01, 0.0, 0.0]])
    set_velocities(model, velocities)
    sliced = slice_in_time(model.gaussians().to(torch.float64), 0.0)
    assert sliced.variance_t is not None
    np.testing.assert_allclose(sliced.velocity.numpy(), velocities, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(sliced.variance_t.numpy(), 0.25**2, rtol=1e-5)
    covariance = (sliced.factor @ sliced.factor.mT).numpy() / scale**2
    np.testing.assert_allclose(covariance, np.broadcast_to(np.eye(3), (4, 3, 3)), atol=1e-5)


def test_the_temporal_scale_stays_the_last_one() -> None:
    """Densification and regularization take the fourth scale for the temporal one, the others for spatial."""
    model = Model(ModelKind("full", 0, 0), {
        name: torch.zeros(1, *row) for name, row in ModelKind("full", 0, 0).shapes().items()
    })  # fmt: skip
    model.parameters["quat_left"][:, 0] = model.parameters["quat_right"][:, 0] = 1
    model.parameters["log_scale"][:] = torch.tensor([0.02, 0.02, 0.02, 0.5]).log()
    set_velocities(model, np.array([[0.3, -0.2, 0.5]]))
    assert model.parameters["log_scale"][0, :3].exp().max() < 0.03 and model.parameters["log_scale"][0, 3].exp() > 0.5
