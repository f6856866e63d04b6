"""Metrics of motion: against loops, and for a Gaussian with a known motion in closed form."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from moving_gaussian import DEPTH, DT, FOCAL, VELOCITY, moving_gaussian, scene_with_truth
from tiny import evaluation_config, tiny_scene
from tiny_film import tiny_film

from datasets.scene import Scene
from pipeline.evaluation.evaluate import evaluate
from pipeline.evaluation.image_metrics import depth_errors, flow_errors, masked_psnr
from pipeline.evaluation.metrics import METRICS, means
from pipeline.evaluation.moving_pixels import BY_COLOUR, BY_TRUTH, MovingPixels
from pipeline.evaluation.quick_evaluate import quick_evaluate
from pipeline.model.model import Model, ModelKind
from rasterizer import Rasterizer

RNG = np.random.default_rng(0)
WITH_TRUTH = [key for key, metric in METRICS.items() if metric.group in ("region", "flow", "depth", "lidar")]


def test_psnr_over_a_mask_by_a_loop() -> None:
    image, truth = RNG.random((2, 6, 5, 3)).astype(np.float32)
    mask = RNG.random((6, 5)) < 0.4
    total, count = 0.0, 0
    for y in range(6):
        for x in range(5):
            if mask[y, x]:
                for c in range(3):
                    total, count = total + (float(image[y, x, c]) - float(truth[y, x, c])) ** 2, count + 1
    assert masked_psnr(image, truth, mask) == pytest.approx(-10 * math.log10(total / count))
    assert masked_psnr(image, truth, np.zeros((6, 5), bool)) is None


def test_flow_and_depth_errors_by_a_loop() -> None:
    flow, truth = RNG.normal(size=(2, 2, 6, 5))
    mask = RNG.random((6, 5)) < 0.5
    errors = [math.dist(flow[:, y, x], truth[:, y, x]) for y, x in zip(*np.nonzero(mask))]
    lengths = [math.hypot(*truth[:, y, x]) for y, x in zip(*np.nonzero(mask))]
    found = flow_errors(flow, truth, mask)
    assert found == pytest.approx(
        {
            "flow_error_px": sum(errors) / len(errors),
            "flow_true_px": sum(lengths) / len(lengths),
            "flow_error": sum(errors) / sum(lengths),
        }
    )
    depth, known = RNG.uniform(1, 2, (2, 6, 5))
    known[0] = 0
    relative = sorted(abs(depth[y, x] - known[y, x]) / known[y, x] for y in range(1, 6) for x in range(5))
    assert depth_errors(depth, known) == pytest.approx(
        {"depth_error_median": relative[12], "depth_error_mean": sum(relative) / 25}
    )


def test_means_are_over_the_images_that_have_the_number() -> None:
    nothing = dict.fromkeys(METRICS)
    rows = [
        nothing | {"psnr_still": 30.0},  # nothing moves in it
        nothing
        | {"psnr_still": 32.0, "psnr_moving": 20.0, "flow_error_px": 1.0, "flow_true_px": 2.0, "flow_error": 0.5},
        nothing
        | {"psnr_still": 34.0, "psnr_moving": 10.0, "flow_error_px": 2.0, "flow_true_px": 8.0, "flow_error": 0.25},
    ]
    found = means(rows)
    assert (found["psnr_still"], found["psnr_moving"], found["psnr_foreground"]) == (32.0, 15.0, None)
    assert found["flow_error"] == pytest.approx(3.0 / 10.0)  # 1.5 px of 5 px


# --- a Gaussian with a known motion -----------------------------------------------------------------------------------


@pytest.mark.parametrize("times_as_fast, error", [(1.0, 0.0), (0.0, 1.0), (1.5, 0.5), (-1.0, 2.0)])
def test_flow_error_of_a_gaussian_with_a_known_velocity(times_as_fast: float, error: float, tmp_path: Path) -> None:
    found = evaluate(moving_gaussian(times_as_fast * VELOCITY), scene_with_truth(tmp_path), evaluation_config(), 1)
    # The velocity is right but for 1e-6 of it, and the rasterizer computes in float32.
    assert found.metrics["flow_error"] == pytest.approx(error, abs=1e-4)
    assert found.metrics["flow_true_px"] == pytest.approx(FOCAL * VELOCITY * DT / DEPTH, rel=1e-6)
    assert found.metrics["flow_error_px"] == pytest.approx(error * FOCAL * VELOCITY * DT / DEPTH, abs=1e-4)
    assert found.metrics["depth_error_median"] == pytest.approx(0.0, abs=1e-5)
    assert found.metrics["moving_by"] == BY_TRUTH and found.metrics["psnr_foreground"] is None


def test_a_model_without_time_has_flow_error_1(tmp_path: Path) -> None:
    moving = moving_gaussian(0.0)
    still = Model(
        ModelKind("static", 0, 0),
        {name: tensor[:, :3] if name in ("mean", "log_scale") else tensor
         for name, tensor in moving.parameters.items() if name != "quat_right"},
    )  # fmt: skip
    found = evaluate(still, scene_with_truth(tmp_path), evaluation_config(), 1).metrics
    assert found["flow_error"] == 1.0 and found["depth_error_median"] == pytest.approx(0.0, abs=1e-5)


def test_final_resolution_reduces_mask_and_flow(tmp_path: Path) -> None:
    """At half the size motion in pixels is half, and its error as a share of it stays."""
    cfg = evaluation_config()
    half = replace(cfg, train=replace(cfg.train, resolution_scale=0.5))
    found = evaluate(moving_gaussian(0.5 * VELOCITY), scene_with_truth(tmp_path), half, 1).metrics
    assert found["flow_true_px"] == pytest.approx(0.5 * FOCAL * VELOCITY * DT / DEPTH, rel=1e-6)
    assert found["flow_error"] == pytest.approx(0.5, abs=1e-4)


def test_parts_of_an_image_have_its_squared_error(tmp_path: Path) -> None:
    """The MSE is the mean of those of moving and of other pixels, weighted by their numbers."""
    found = evaluate(moving_gaussian(0.0), scene_with_truth(tmp_path), evaluation_config(), 1).per_image[0]
    share = found["moving_share"]
    mse = {name: 10 ** (-found[name] / 10) for name in ("psnr", "psnr_moving", "psnr_still")}
    assert 0 < share < 1
    assert mse["psnr"] == pytest.approx(share * mse["psnr_moving"] + (1 - share) * mse["psnr_still"])


# --- which pixels move ------------------------------------------------------------------------------------------------


def test_a_still_camera_sees_motion_by_colour() -> None:
    scene = tiny_film(frames=4)
    found = MovingPixels(scene, 1.0)
    y, x = np.mgrid[:32, :32] + 0.5
    discs = np.stack([(x - (10 + 3 * frame)) ** 2 + (y - 16) ** 2 < 36 for frame in range(4)])
    expected = discs.any(axis=0) & ~discs.all(axis=0)  # inside of all discs the colour stays
    for index in range(len(scene.test)):
        np.testing.assert_array_equal(found.of(index), expected)
    assert found.source(0) == BY_COLOUR


@pytest.mark.parametrize("scene", [tiny_film(frames=2), tiny_scene(static=True)], ids=["two frames", "static"])
def test_without_truth_and_a_still_camera_nothing_is_known(scene: Scene) -> None:
    found = MovingPixels(scene, 1.0)
    assert {found.of(index) is None for index in range(len(scene.test))} == {True} and found.source(0) is None


def test_views_without_truth_have_no_numbers_of_motion() -> None:
    found = evaluate(moving_gaussian(0.0), tiny_scene(), evaluation_config(), 1)
    assert {found.metrics[name] for name in (*WITH_TRUTH, "moving_by")} == {None}


def test_foreground_is_where_alpha_is() -> None:
    scene = tiny_scene()
    alpha = np.zeros((32, 32), np.uint8)
    alpha[10:20, 8:12], alpha[0, 0] = 255, 1
    test = (replace(scene.test[0], coverage=alpha), scene.test[1])  # an opaque view is all foreground
    images = {}
    found = evaluate(
        moving_gaussian(0.0),
        replace(scene, test=test),
        evaluation_config(renders=-1),
        1,
        lambda name, seen: images.update({name: (seen.image, seen.truth)}),
    )
    image, truth = images[test[0].name]
    assert found.per_image[0]["psnr_foreground"] == pytest.approx(masked_psnr(image, truth, alpha > 0))
    assert found.per_image[1]["psnr_foreground"] == found.per_image[1]["psnr"]


def test_quick_evaluation_has_the_same_moving_pixels(tmp_path: Path) -> None:
    model, scene, cfg = moving_gaussian(0.0), scene_with_truth(tmp_path), evaluation_config()
    quick = quick_evaluate(model, scene, cfg, Rasterizer(threads=1))["psnr_moving"]
    assert quick == pytest.approx(evaluate(model, scene, cfg, 1).metrics["psnr_moving"], abs=1e-4)
