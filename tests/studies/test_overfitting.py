"""Overfitting: lifetimes, effective view counts, the history from a log, error in moving and static pixels."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
import torch
from tiny import tiny_config, tiny_scene

from pipeline.evaluation.lifetimes import BIN_EDGES, QUANTILES, lifetimes
from pipeline.model.initialise import initialise
from pipeline.studies.overfitting.effective_view_count import effective_view_count
from pipeline.studies.overfitting.error_by_motion import split_error
from pipeline.studies.overfitting.history import read_history
from pipeline.studies.overfitting.plot import image_grid
from rasterizer import Request
from rasterizer.reference.blend import blend
from rasterizer.reference.render import make_splats


def test_lifetimes_of_unrotated_gaussians_are_their_temporal_scales():
    scene = tiny_scene(views=8)
    model = initialise(scene, tiny_config(), np.random.default_rng(0))
    frames = torch.linspace(1, 30, len(model))
    model.parameters["log_scale"][:, 3] = torch.log(frames / 7)  # eight times, seven intervals
    # a few float32 roundings of logarithm and exponential
    found = lifetimes(model, scene)
    assert found["quantiles"] == pytest.approx(np.quantile(frames.numpy(), QUANTILES).tolist(), rel=1e-5)
    edges = BIN_EDGES * (1 + 1e-6)  # values on an edge may round to either side; of 200 these are 1, 2, 4, 8, 16
    assert np.abs(np.array(found["counts"]) - np.histogram(frames.numpy(), edges)[0]).sum() <= 10
    assert sum(found["counts"]) == len(model)


def test_lifetimes_outside_the_histogram_count_in_its_end_bins():
    scene = tiny_scene(views=8)
    model = initialise(scene, tiny_config(), np.random.default_rng(0))
    model.parameters["log_scale"][:, 3] = -30.0
    model.parameters["log_scale"][:50, 3] = 30.0
    counts = lifetimes(model, scene)["counts"]
    assert (counts[0], counts[-1], sum(counts)) == (len(model) - 50, 50, len(model))


def test_static_model_has_no_lifetimes():
    scene = tiny_scene(static=True)
    assert lifetimes(initialise(scene, tiny_config(), np.random.default_rng(0)), scene) is None


def test_effective_view_count_equals_that_of_reference_weights():
    scene, cfg = tiny_scene(views=3), tiny_config()
    model = initialise(scene, cfg, np.random.default_rng(0))
    model.parameters["sh"][::2, 0] = -2.0  # black: no colour gradient, but they occlude
    # The reference blends features linearly: an indicator feature for each Gaussian gives the image of its weights.
    truth = torch.zeros(len(scene.train), len(model), dtype=torch.float64)
    doubles = type(model.gaussians())(**{name: tensor.double() for name, tensor in model.gaussians().tensors().items()})
    for row, view in zip(truth, scene.train):
        splats = make_splats(doubles, Request(view.camera, view.time, scene.duration, near=cfg.scene.near))
        count = len(splats.index)
        indicators = type(splats)(**{**vars(splats), "features": torch.eye(count, dtype=torch.float64)})
        row[splats.index] += blend(indicators, view.camera)[0].sum(dim=(1, 2))
    solid = truth.sum(dim=0) > 1  # one pixel in total; below it a pair next to α' = 1/255 is a large part
    views = truth.sum(dim=0).square() / truth.square().sum(dim=0).clamp(min=1e-30)
    assert solid.sum() > 50
    torch.testing.assert_close(
        effective_view_count(model, scene, cfg, 1)[solid].double(), views[solid], rtol=1e-2, atol=0
    )


def test_effective_view_count_of_equal_views_is_their_number():
    scene, cfg = tiny_scene(views=4, static=True), tiny_config()
    model = initialise(scene, cfg, np.random.default_rng(0))
    model.parameters["mean"][::2, 2] += 100.0  # behind the camera
    alone = dataclasses.replace(scene, train=scene.train[:1])
    once = effective_view_count(model, alone, cfg, 1)
    visible = once > 0
    assert visible.any() and not visible.all()
    # One rounding of the square and one of the quotient.
    torch.testing.assert_close(once[visible], torch.ones(int(visible.sum())), rtol=1e-6, atol=0)
    thrice = effective_view_count(model, dataclasses.replace(scene, train=scene.train[:1] * 3), cfg, 1)
    torch.testing.assert_close(thrice[visible], torch.full((int(visible.sum()),), 3.0), rtol=1e-6, atol=0)


def write_run(folder, rows):
    folder.mkdir()
    (folder / "metrics.json").write_text(json.dumps({"train": "fast", "ablation": "full", "scene": "s", "seed": 1}))
    (folder / "log.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))


def test_history_of_a_log_keeps_one_of_repeated_evaluations(tmp_path):
    rows = [
        {
            "event": "evaluate",
            "iteration": i,
            "psnr": 20 + k,
            "train_psnr": 25 + k,
            "lifetimes": {"quantiles": [1, 2, 3, 4, 5], "counts": [0] * 64},
        }
        for k, i in enumerate((500, 1000, 1000, 1500))
    ]
    write_run(tmp_path / "run", [{"event": "start"}, *rows])
    with (tmp_path / "run" / "log.jsonl").open("a") as log:
        log.write('{"event": "evalu')  # cut short by a kill
    found = read_history(tmp_path / "run")
    assert found.label == "fast, seed 1"
    assert found.iteration.tolist() == [500, 1000, 1500]
    assert found.psnr.tolist() == [20, 22, 23]
    assert found.lifetimes.shape == (3, 5) and found.lifetime_counts.shape == (3, 64)


@pytest.mark.parametrize(
    "rows, found",
    [([], "found none"), ([{"event": "evaluate", "iteration": 1, "psnr": 1}], "found a run of an earlier version")],
)
def test_history_of_an_unusable_log_is_an_error(tmp_path, rows, found):
    write_run(tmp_path / "run", rows)
    with pytest.raises(ValueError, match=found):
        read_history(tmp_path / "run")


def test_metrics_without_the_name_of_the_run_are_an_error(tmp_path):
    write_run(tmp_path / "run", [{"event": "evaluate", "iteration": 1, "psnr": 1, "train_psnr": 1}])
    (tmp_path / "run" / "metrics.json").write_text('{"train": "fast"}')
    with pytest.raises(ValueError, match=r"metrics\.json: expected ablation, seed, scene, found none"):
        read_history(tmp_path / "run")


def test_image_grid_places_every_image():
    a, b = np.zeros((4, 5, 3)), np.ones((4, 5, 3)) * 0.5
    pixels = np.asarray(image_grid([[a, b], [b]]))
    assert pixels.shape == (4 + 6 + 4, 5 + 6 + 5, 3)
    assert (pixels[:4, :5] == 0).all() and (pixels[:4, 11:] == 128).all() and (pixels[10:, :5] == 128).all()
    assert (pixels[10:, 11:] == 255).all()


def moving_dot(views=5):
    """(V, 21, 31, 3) float32: a white dot that moves along the middle row of a grey image; and (V, 21, 31) where."""
    images, there = np.full((views, 21, 31, 3), 0.5, np.float32), np.zeros((views, 21, 31), bool)
    for k in range(views):
        images[k, 10, 10 + k], there[k, 10, 10 + k] = 1.0, True
    return images, there


def test_error_is_split_between_moving_and_static_pixels():
    truth, moving = moving_dot()
    rendered = truth + np.where(moving[..., None], np.float32(0.1), np.float32(0.01))
    error = split_error(truth, rendered, moving)
    # 0.1 and 0.01 added to 0.5 and 1 in float32: relative error 1e-5 of the smaller, twice that squared
    assert error.moving_fraction == pytest.approx(1 / (21 * 31))
    assert (error.moving_psnr, error.static_psnr) == pytest.approx((20.0, 40.0), abs=1e-3)
    assert error.moving_error == pytest.approx(0.01 / (0.01 + (21 * 31 - 1) * 0.0001), rel=1e-4)


def test_static_images_have_no_split():
    still = np.full((3, 8, 8, 3), 0.5, np.float32)
    assert split_error(still, still + 0.1, np.zeros((3, 8, 8), bool)) is None
    assert split_error(still, still + 0.1, np.ones((3, 8, 8), bool)) is None
