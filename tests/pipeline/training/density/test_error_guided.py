"""Error-guided densification: against spheres whose place, time and colour are known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tiny import TinyRun, tiny_config, tiny_scene, train_tiny

from datasets.scene import Scene, View
from pipeline.config.schema import AblationConfig
from pipeline.config.train_schema import DensifyConfig, TrainConfig
from pipeline.model.initialise import initialise
from pipeline.model.model import Model
from pipeline.training.density import error_guided
from pipeline.training.density.error_guided import (
    FEWEST_VIEWS,
    MIN_ERROR,
    TEMPORAL_SCALE,
    ErrorGuidedDensification,
    ErrorSampler,
)

CENTRE, RADIUS = np.array([0.45, -0.2, 0.3]), 0.35  # of the sphere, world units
COLOR = (40, 200, 90)
FRAMES = 21
NEAR = 0.2  # world units
SHOWN = range(8, 13)  # the views, and so the times, that show it


def sphere_scene(cameras: int = 1) -> Scene:
    """Black, but for a sphere that exists at the times SHOWN; `cameras` views of each time, from other directions."""
    corner, views = tiny_scene(4), []
    for frame in range(FRAMES):
        for number in range(cameras):
            camera = corner.train[(frame + number) % 4].camera
            image = np.zeros((camera.height, camera.width, 3), np.uint8)
            if frame in SHOWN:
                y, x = np.mgrid[: camera.height, : camera.width] + 0.5
                direction = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], -1)
                direction = direction @ camera.world_to_cam[:3, :3]
                direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
                to_centre = CENTRE - camera.position
                closest = np.linalg.norm(np.cross(direction, to_centre), axis=-1)  # of the ray to the centre
                image[closest < RADIUS] = COLOR
            views.append(View(camera, frame / (FRAMES - 1), image, f"train/{frame}_{number}"))
    return replace(corner, train=tuple(views))


def transparent_model(scene: Scene) -> Model:
    model = initialise(scene, tiny_config(), np.random.default_rng(0))
    model.parameters["opacity_logit"].fill_(-30.0)
    return model


def draw(scene: Scene, count: int = 300, model: Model | None = None, seed: int = 0) -> dict[str, torch.Tensor] | None:
    model = transparent_model(scene) if model is None else model
    return ErrorSampler(scene, NEAR).draw(model, count, np.random.default_rng(seed), threads=1)


@pytest.mark.parametrize("cameras", [1, 4])
def test_new_gaussians_are_where_and_when_the_object_is(cameras: int):
    scene = sphere_scene(cameras)
    rows = draw(scene)
    assert rows is not None
    position, time = rows["mean"][:, :3].numpy(), rows["mean"][:, 3].numpy()
    # The four cameras are 0.3 rad apart on an arc. Where their silhouettes of the sphere meet is up to 1 / sin(0.45) =
    # 2.3 radii from its centre along the viewing direction, and the errors are averages over 3 × 3 of 32 pixels, 0.1
    # world units each.
    distance = np.linalg.norm(position - CENTRE, axis=1)
    assert np.median(distance) < 1.2 * RADIUS and distance.max() < 2.3 * RADIUS + 0.3
    # With one camera a neighbour's error is a sample, too: a quarter of five views is the second smallest.
    margin = 1 if cameras == 1 else 0
    frame = time * (FRAMES - 1)
    assert SHOWN[0] - margin - 0.01 < frame.min() and frame.max() < SHOWN[-1] + margin + 0.01
    color = 0.5 + 0.28209479177387814 * rows["sh"][:, 0].numpy()
    inside = distance < RADIUS
    assert inside.mean() > 0.3  # of points uniform in the box: 0.013
    # The median of at least three of five views that show the sphere's colour; elsewhere its border's.
    np.testing.assert_allclose(np.median(color[inside], axis=0), np.array(COLOR) / 255, atol=1e-3)
    assert not rows["sh"][:, 1:].any()


def test_new_gaussians_are_small_short_lived_and_at_rest():
    scene = sphere_scene()
    rows = draw(scene)
    assert rows is not None
    np.testing.assert_allclose(rows["log_scale"][:, 3].exp(), TEMPORAL_SCALE * scene.frame_spacing, rtol=1e-6)
    depth = np.linalg.norm(rows["mean"][:, :3].numpy() - scene.train[0].camera.position, axis=1)
    pixel = depth / scene.train[0].camera.fx
    # All cameras are at a distance of 4 from the origin; depth along the axis and distance differ by at most a tenth.
    ratio = rows["log_scale"][:, :3].exp().numpy() / (error_guided.RADIUS * pixel[:, None])
    assert ratio.min() > 0.6 and ratio.max() < 1.6
    for name in ("quat_left", "quat_right"):
        assert (rows[name] == torch.tensor([1.0, 0, 0, 0])).all()


def test_nothing_is_added_where_the_model_is_right():
    scene = sphere_scene()
    black = replace(scene, train=tuple(replace(view, image=np.zeros_like(view.image)) for view in scene.train))
    assert draw(black) is None
    # A constant error below the threshold.
    faint = np.full((32, 32, 3), int(255 * MIN_ERROR) - 1, np.uint8)
    assert draw(replace(scene, train=tuple(replace(view, image=faint) for view in scene.train))) is None


@pytest.mark.parametrize("masked", [False, True])
def test_score_and_colour_equal_those_of_a_naive_loop(masked: bool):
    scene = sphere_scene()
    valid = np.ones((32, 32), bool)
    if masked:  # a projection there is as unknown as one outside the image
        valid[:, ::2] = False
        scene = replace(scene, train=tuple(replace(view, mask=valid) for view in scene.train))
    sampler, rng = ErrorSampler(scene, NEAR), np.random.default_rng(3)
    views = [6, 7, 8, 9, 10]
    errors = sampler._errors(transparent_model(scene), views, 1)
    points = rng.uniform(-1.5, 1.5, size=(200, 3))
    score, color = sampler._scored(points, views, errors)
    for i, point in enumerate(points):
        found, colors = [], []
        for index in views:
            camera, image = scene.train[index].camera, scene.train[index].image / 255
            x, y, z = camera.world_to_cam[:3, :3] @ point + camera.world_to_cam[:3, 3]
            column, row = int(np.floor(camera.fx * x / z + camera.cx)), int(np.floor(camera.fy * y / z + camera.cy))
            if 0 <= column < 32 and 0 <= row < 32 and valid[row, column]:
                found.append(errors[index][row, column])
                colors.append(image[row, column])
        expected = np.quantile(found, 0.25) if len(found) >= FEWEST_VIEWS else 0.0
        assert score[i] == pytest.approx(expected, abs=1e-6)  # float32 errors
        known = len(found) >= FEWEST_VIEWS
        np.testing.assert_allclose(color[i], np.median(colors, axis=0) if known else 0.0, atol=1e-6)


@pytest.mark.parametrize("box", [(-0.6, 0.6), (-1.2, 1.2), (-3.0, 3.0)])
def test_new_gaussians_are_in_the_box_of_the_initial_ones(box: tuple[float, float]):
    """The images are wrong everywhere."""
    noise = np.random.default_rng(1)
    scene = sphere_scene(cameras=4)
    wrong = [replace(view, image=noise.integers(100, 255, (32, 32, 3), np.uint8)) for view in scene.train]
    scene = replace(scene, train=tuple(wrong), init_box=box)
    rows = ErrorSampler(scene, NEAR).draw(transparent_model(scene), 300, np.random.default_rng(0), threads=1)
    assert rows is not None
    low, high = box
    found = rows["mean"][:, :3].numpy()
    assert (found >= low - 1e-6).all() and (found <= high + 1e-6).all()
    assert np.abs(found).max() > 0.7 * high, "most of the box"


def test_quantiles_are_numpys():
    values = np.random.default_rng(0).normal(size=(6, 50, 3))
    values[np.random.default_rng(1).random(values.shape) < 0.4] = np.nan
    values[0] = 0.3
    for quantile in (0.25, 0.5, 1.0):
        found = error_guided.quantile_of_known(values, quantile)
        np.testing.assert_allclose(found, np.nanquantile(values, quantile, axis=0), rtol=1e-12, atol=1e-15)


def test_the_draw_is_a_function_of_its_generator():
    scene = sphere_scene()
    first, again, other = draw(scene), draw(scene), draw(scene, seed=1)
    assert first is not None and again is not None and other is not None
    assert all(torch.equal(first[name], again[name]) for name in first)
    assert not torch.equal(first["mean"], other["mean"])


def test_of_a_long_film_some_times_are_rendered(monkeypatch: pytest.MonkeyPatch):
    scene = sphere_scene(cameras=4)
    monkeypatch.setattr(error_guided, "MAX_VIEWS", 24)
    windows = ErrorSampler(scene, NEAR)._windows(np.random.default_rng(0))
    assert len(windows) == 6 and all(len(views) == 4 for views in windows.values())
    assert all(scene.train[view].time == time for time, views in windows.items() for view in views)


def test_schedule():
    cfg = TrainConfig(densify=DensifyConfig(start=20, stop=100, add_by_error=1.0, add_by_error_every=10))
    found = ErrorGuidedDensification(tiny_scene(), replace(tiny_config(), train=cfg))
    assert [i for i in range(1, 130) if found.due(i, float(i))] == [20, 30, 40, 50, 60, 70, 80, 90]
    none = TrainConfig(densify=DensifyConfig(start=20, stop=100))
    assert not ErrorGuidedDensification(tiny_scene(), replace(tiny_config(), train=none)).due(20, 20.0)


def train_with(path: Path, time_split: bool = True, allowed: bool = True, **densify) -> list[dict]:
    cfg = tiny_config()
    rules = replace(cfg.train.densify, space_gradient=1e9, use_time_gradient=False, **densify)
    ablation = AblationConfig(time_split=time_split, add_by_error=allowed)
    cfg = replace(cfg, ablation=ablation, train=replace(cfg.train, densify=rules))
    train_tiny(path, cfg, sphere_scene())
    return [row for row in TinyRun(path).rows("log.jsonl") if row["event"] == "add_by_error"]


def test_training_adds_up_to_the_cap_and_never_without_add_by_error(tmp_path: Path):
    events = train_with(tmp_path / "full", add_by_error=0.15, add_by_error_every=10)
    assert [row["iteration"] for row in events] == [10, 20, 30, 40]
    assert all(0 < row["added"] <= 60 and row["n_gaussians"] <= 400 for row in events)
    capped = train_with(tmp_path / "capped", add_by_error=0.15, add_by_error_every=10, max_gaussians=210)
    assert all(row["n_gaussians"] <= 210 for row in capped)
    rules = dict(add_by_error=0.15, add_by_error_every=10)
    assert len(train_with(tmp_path / "kept", time_split=False, **rules)) == 4
    assert train_with(tmp_path / "without", allowed=False, **rules) == []


def test_a_share_of_what_pruning_leaves_bounds_the_additions(tmp_path: Path):
    rules = dict(add_by_error=0.1, add_by_error_every=10)
    added = train_with(tmp_path, **rules, prune_sensitivity=0.05, prune_sensitivity_every=10)
    pruned = [row for row in TinyRun(tmp_path).rows("log.jsonl") if row["event"] == "prune_sensitivity"]
    assert [row["iteration"] for row in added] == [row["iteration"] for row in pruned][:4] == [10, 20, 30, 40]
    for left, row in zip(pruned, added):
        assert row["n_gaussians"] - row["added"] == left["n_gaussians"]
        assert row["added"] == int(0.1 * left["n_gaussians"])
    assert added[0]["added"] > 0


def test_what_a_mask_leaves_out_attracts_no_gaussians():
    """Here those are all pixels with an error."""
    scene = sphere_scene()
    masked = replace(scene, train=tuple(replace(view, mask=~view.image.any(axis=2)) for view in scene.train))
    assert draw(scene) is not None and draw(masked) is None
