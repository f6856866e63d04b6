"""Ground truth of motion in synthetic scenes: against the pinhole projection of a moving sphere, and a full trace."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from datasets.ground_truth import StoredTruth
from datasets.settings import SceneConfig
from datasets.source import open_source
from datasets.synthetic import build_scene
from datasets.synthetic.film import write_film_truth
from datasets.synthetic.shapes import Rectangle, Sphere
from datasets.synthetic.texture import plain
from datasets.synthetic.trace import trace
from datasets.synthetic.video import FRAME_RATE
from datasets.synthetic.world import Body, Light, Material, Pose, World, moves, rest, steady
from datasets.synthetic.write_film import FilmSettings
from rasterizer.camera import Camera

SMALL = {"size": 48, "train_views": 6, "test_views": 4}


def world_with_a_ball() -> World:
    """A wall at z = 5, a lamp at rest that changes its light, and a ball at z = 3 that moves right at 1.2 a second."""
    white = Material(plain((1.0, 1.0, 1.0)))
    lamp = Material(plain((0.0, 0.0, 0.0)), glow=lambda time: np.array([time, 0.0, 0.0]))
    ball = Body(
        Sphere(0.4),
        white,
        lambda time: Pose(np.array([-0.5 + 1.2 * time, 0.1, 3.0]), np.eye(3)),
        casts_shadow=False,
        changes=True,
    )
    return World(
        bodies=(
            Body(Rectangle((20.0, 20.0)), white, rest((0, 0, 5.0))),
            Body(Sphere(0.3), lamp, rest((0.9, -0.6, 3.0)), casts_shadow=False, changes=True),
            ball,
        ),
        lights=(Light((0.0, 0.0, -5.0), 0.1, steady(0.5, 0.5, 0.5)),),
    )


def test_a_filmed_ball_by_its_projection(tmp_path: Path) -> None:
    camera, times = Camera(80, 60, 70.0, 70.0, 40.0, 30.0, np.eye(4)), np.array([0.0, 0.2, 0.5])
    write_film_truth(tmp_path / "cam00.npz", world_with_a_ball(), camera, times, 0.1)
    x, y = (np.meshgrid(np.arange(80) + 0.5, np.arange(60) + 0.5) - np.array([[[40.0]], [[30.0]]])) / 70.0
    for frame, time in enumerate(times):
        truth = StoredTruth(tmp_path / "cam00.npz", frame).read()
        assert truth.flow_dt == 0.1
        centre = np.array([-0.5 + 1.2 * time, 0.1, 3.0])
        along = x * centre[0] + y * centre[1] + centre[2]
        discriminant = along**2 - (x**2 + y**2 + 1) * (centre @ centre - 0.4**2)
        sure, hit = np.abs(discriminant) > 1e-3, discriminant > 0  # not for grazing rays
        assert hit.sum() > 100 and truth.moving is not None and truth.depth is not None and truth.flow is not None
        np.testing.assert_array_equal(truth.moving[sure], hit[sure])  # the lamp changes its light, but does not move
        z = (along - np.sqrt(np.maximum(discriminant, 0))) / (x**2 + y**2 + 1)
        # float16 has 11 bits: half of the last is 2.4e-4 of the value. Off the silhouette the rest is below.
        inside = hit & sure
        np.testing.assert_allclose(truth.depth[inside], z[inside], rtol=6e-4)
        np.testing.assert_allclose(truth.flow[0][inside], 70 * 1.2 * 0.1 / z[inside], rtol=1e-3)
        assert np.abs(truth.flow[1][inside]).max() < 1e-3 and np.abs(truth.flow[:, sure & ~hit]).max() < 1e-3
        lamp = (x * 3 - 0.9) ** 2 + (y * 3 + 0.6) ** 2 < 0.2**2
        assert (truth.depth[~hit & ~lamp] > 2.6).all() and np.median(truth.depth[~hit]) == 5


def test_truth_of_the_counter_equals_a_full_trace(tmp_path: Path) -> None:
    settings = FilmSettings(scene="counter", seed=0, size=64, cameras=3, frames=4, samples=1)
    world, cameras = settings.set_up()
    folder = build_scene(tmp_path / "counter", scene="counter", seed=0, size=64, cameras=3, frames=4, samples=1)
    moving = [index for index, body in enumerate(world.bodies) if moves(body.motion, settings.times)]
    assert 0 < len(moving) < sum(body.changes for body in world.bodies)  # the bulb and the screen only flicker
    for number in range(3):
        for frame in (0, 3):
            traced = trace(world, cameras[number], settings.times[frame], flow_dt=1 / FRAME_RATE, samples=1)
            truth = StoredTruth(folder / "truth" / f"cam{number:02d}.npz", frame).read()
            np.testing.assert_array_equal(truth.moving, np.isin(traced.body, moving))
            np.testing.assert_allclose(truth.depth, traced.depth, rtol=6e-4)  # float16
            on_moving = np.isin(traced.body, moving)
            assert truth.flow is not None and on_moving.sum() > 20
            # float16; elsewhere the full trace has rounding errors of float32 at the same place, 1e-4 px.
            np.testing.assert_allclose(truth.flow[:, on_moving], traced.flow[:, on_moving], rtol=1e-3, atol=1e-3)
            np.testing.assert_array_equal(truth.flow_valid, traced.flow_valid)


def test_a_film_from_a_later_frame_at_half_size_has_the_truth_of_its_frames(tmp_path: Path) -> None:
    common = {"reader": "synthetic", "size": 64, "cameras": 3, "frames": 4, "cache": str(tmp_path)}
    cfg = SceneConfig(name="synthetic/counter", downscale=2, first_frame=1, **common)
    scene = open_source(cfg, threads=1).scene()
    assert [view.name for view in scene.test] == [f"test/cam00_{frame:04d}" for frame in (1, 2, 3)]
    for frame, view in enumerate(scene.test, 1):
        assert view.truth is not None
        small, full = view.truth.read(), StoredTruth(scene.source / "truth" / "cam00.npz", frame).read()
        assert small.moving is not None and small.moving.shape == (view.camera.height, view.camera.width)
        assert full.moving is not None and full.depth is not None
        np.testing.assert_array_equal(small.moving, full.moving.reshape(24, 2, 32, 2).any(axis=(1, 3)))
        np.testing.assert_array_equal(small.depth, full.depth[1::2, 1::2])
        assert view.truth.read(moving_only=True).depth is None


@pytest.mark.parametrize("name, moves_there", [("wheel", True), ("burst", True), ("lamp", False), ("still", False)])
def test_moving_pixels_of_photographed_scenes(name: str, moves_there: bool, tmp_path: Path) -> None:
    """Lamps change their light and nothing else; of the others, a moving body's flow is not that of a still world."""
    cfg = SceneConfig(name=f"synthetic/{name}", reader="synthetic", downscale=1, cache=str(tmp_path), **SMALL)
    views = open_source(cfg).scene().test
    masks = []
    for view in views:
        assert view.truth is not None
        truth = view.truth.read()
        assert truth.moving is not None and truth.flow is not None and truth.flow_valid is not None
        masks.append(truth.moving)
        # The camera is the same at both times: what does not move has no flow but rounding, what moves mostly has.
        length = np.linalg.norm(truth.flow, axis=0)
        assert (length[~truth.moving] < 1e-2).all()
        if (known := truth.moving & truth.flow_valid).any():
            assert (length[known] > 1e-2).mean() > 0.9
    assert any(mask.any() for mask in masks) == moves_there


def test_a_scene_in_other_units_has_its_truth_in_them(tmp_path: Path) -> None:
    """Depth and flow_dt follow the cameras and times of the canonical scene: points stay on the same surface."""
    from datasets.canonical import Canonical, canonicalise

    cfg = SceneConfig(name="synthetic/wheel", reader="synthetic", downscale=1, cache=str(tmp_path), **SMALL)
    scene = open_source(cfg).scene()
    moved = canonicalise(scene, Canonical((0.5, -1.0, 2.0), 3.0, 0.0, 0.25))
    before, after = scene.test[0].truth, moved.test[0].truth
    assert before is not None and after is not None
    one, two = before.read(), after.read()
    np.testing.assert_allclose(two.depth, 3.0 * one.depth, rtol=1e-6)
    assert two.flow_dt == pytest.approx(0.25 * one.flow_dt)
