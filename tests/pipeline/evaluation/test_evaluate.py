"""The full evaluation, of models with known quality."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest
import torch
from tiny import SIZE, evaluation_config, tiny_config, tiny_scene
from tiny_film import tiny_film

from datasets.scene import Scene, View
from pipeline.evaluation import evaluate as evaluation
from pipeline.evaluation import lpips
from pipeline.evaluation.evaluate import evaluate, refuse_small_images
from pipeline.evaluation.image_metrics import psnr
from pipeline.evaluation.metrics import METRICS, MeasuredView, Metric, quality_table
from pipeline.model.initialise import initialise
from pipeline.model.model import Model


@pytest.fixture(scope="module")
def model() -> Model:
    return initialise(tiny_scene(), tiny_config(), np.random.default_rng(0))


class Known:
    """A network whose distances are known."""

    weights: ClassVar = {"alex.pth": "ab12"}

    def __init__(self, distance: Callable[[], float]) -> None:
        self.distance = distance

    def __call__(self, image: np.ndarray, truth: np.ndarray) -> float:
        return self.distance()


def scene_of(model: Model) -> Scene:
    """A scene whose test images are the model's own renders, rounded to 8 bits."""
    scene = tiny_scene()
    rendered: dict[str, np.ndarray] = {}
    evaluate(model, scene, evaluation_config(renders=-1), 1, lambda name, seen: rendered.update({name: seen.image}))
    test = tuple(replace(view, image=np.round(rendered[view.name] * 255).astype(np.uint8)) for view in scene.test)
    return replace(scene, test=test)


def test_a_model_that_rendered_the_test_images_has_only_rounding_error(model: Model) -> None:
    found = evaluate(model, scene_of(model), evaluation_config(), 1)
    # Rounding errors are at most ½/255: at least 20 log10(2 · 255) = 54 dB.
    assert found.metrics["psnr"] >= 54
    assert found.metrics["ssim"] > 0.999


def test_metrics_are_means_over_the_images(model: Model) -> None:
    scene = tiny_scene()
    found = evaluate(model, scene, evaluation_config(), 2)
    assert [row["view"] for row in found.per_image] == [view.name for view in scene.test]
    for name in ("psnr", "ssim", "dssim1", "dssim2"):
        assert found.metrics[name] == pytest.approx(np.mean([row[name] for row in found.per_image]))
    assert {key for key, metric in METRICS.items() if metric.group != "cost"} <= set(found.metrics)


def test_a_new_metric_is_one_entry_of_the_list(model: Model, monkeypatch) -> None:
    """It is measured on every view, is in metrics.json with its mean, and on the terminal with its unit."""

    def brightest(view: MeasuredView) -> float:
        return float(view.image.max())

    monkeypatch.setitem(
        METRICS, "brightest", Metric("brightest", "Brightest pixel", "%", 1, "", scale=100.0, measure=brightest)
    )
    images: list[np.ndarray] = []
    cfg = evaluation_config(renders=-1)
    found = evaluate(model, tiny_scene(), cfg, 1, lambda name, seen: images.append(seen.image))
    assert [row["brightest"] for row in found.per_image] == [float(image.max()) for image in images]
    assert found.metrics["brightest"] == np.mean([image.max() for image in images], dtype=np.float64)
    table = quality_table(found.metrics, None)
    assert ("Brightest pixel, %", f"{100 * found.metrics['brightest']:.1f}", "–") in table
    assert table[0] == ("PSNR, dB", f"{found.metrics['psnr']:.2f}", "–")


def test_results_do_not_depend_on_the_number_of_threads(model: Model) -> None:
    one, two = (evaluate(model, tiny_scene(), evaluation_config(), threads) for threads in (1, 2))
    assert one.per_image == two.per_image


def test_missing_metrics_are_none_with_a_reason(model: Model) -> None:
    found = evaluate(model, tiny_scene(), evaluation_config(), 1)  # 32 px: too small for MS-SSIM
    assert found.metrics["ms_ssim"] is None and "161 px" in found.note()
    assert found.metrics["lpips_alex"] is None and "evaluate.lpips=false" in found.note()


def test_lpips_without_weights_is_none_with_a_reason(model: Model, monkeypatch) -> None:
    def unavailable(net: str, folder: None) -> None:
        raise lpips.LpipsUnavailable(f"no weights of {net}")

    monkeypatch.setattr(lpips, "load", unavailable)
    found = evaluate(model, tiny_scene(), evaluation_config(lpips=True), 1)
    assert found.metrics["lpips_vgg"] is None
    assert found.metrics["lpips_note"] == "no weights of alex"


def test_lpips_with_weights_is_measured(model: Model, monkeypatch) -> None:
    monkeypatch.setattr(lpips, "load", lambda net, folder: Known(lambda: 0.25))
    found = evaluate(model, tiny_scene(), evaluation_config(lpips=True), 1)
    assert found.metrics["lpips_alex"] == found.metrics["lpips_vgg"] == 0.25
    assert found.metrics["lpips_note"] is None and found.lpips_weights == {"alex.pth": "ab12"}


def test_lpips_vgg_of_large_scenes_is_measured_on_evenly_spread_views(model: Model, monkeypatch) -> None:
    """Networks that return known numbers; the pixel limit allows three of five views."""
    distances = {"alex": iter(range(5)), "vgg": iter((10.0, 20.0, 60.0))}
    monkeypatch.setattr(lpips, "load", lambda net, folder: Known(lambda: float(next(distances[net]))))
    monkeypatch.setattr(lpips, "VGG_PIXELS", 3 * SIZE**2)
    found = evaluate(model, tiny_film(frames=5, held_out=("cam00",)), evaluation_config(lpips=True), 1)
    assert [row["lpips_vgg"] for row in found.per_image] == [10.0, None, 20.0, None, 60.0]
    assert (found.metrics["lpips_alex"], found.metrics["lpips_vgg"]) == (2.0, 30.0)
    assert found.metrics["lpips_note"] == "LPIPS-VGG is of 3 of the 5 test views"


@pytest.mark.parametrize("memory, parallel", [(0, 1), (2.5, 2), (100, 4)])
def test_the_number_of_views_measured_in_parallel_is_limited_by_memory(
    model: Model, monkeypatch, memory: float, parallel: int
) -> None:
    sizes = []
    pool = evaluation.ThreadPoolExecutor
    monkeypatch.setattr(evaluation, "ThreadPoolExecutor", lambda size: sizes.append(size) or pool(size))
    monkeypatch.setattr(evaluation, "MEASURE_BYTES", int(memory * SIZE**2 * evaluation.METRICS_BYTES_PER_PIXEL))
    evaluate(model, tiny_scene(), evaluation_config(), 4)
    assert sizes == [parallel]


def test_n_alive_counts_temporal_marginals_of_at_least_005() -> None:
    cfg = evaluation_config()
    cfg = replace(cfg, ablation=replace(cfg.ablation, rotation_4d=False))
    scene = tiny_scene()
    model = initialise(scene, cfg, np.random.default_rng(0))
    model.parameters["log_scale"][:, 3] = torch.linspace(-4, -1, len(model))
    found = evaluate(model, scene, cfg, 1)
    for row in found.per_image:  # p(t) >= 0.05, without 4D rotation: |t - μt| <= st sqrt(2 ln 20)
        distance = (model.parameters["mean"][:, 3].double() - row["time"]).abs()
        reach = model.parameters["log_scale"][:, 3].double().exp() * np.sqrt(2 * np.log(20))
        assert row["n_alive"] == int((distance <= reach).sum())
    assert found.n_alive_mean == np.mean([row["n_alive"] for row in found.per_image])


def test_flicker_is_measured_on_consecutive_frames_of_each_camera(model: Model) -> None:
    scene, images = tiny_film(frames=5), {}
    scene = replace(scene, test=tuple(view for view in scene.test if view.name != "test/cam05_0002"))
    found = evaluate(
        model,
        scene,
        evaluation_config(renders=-1),
        2,
        lambda name, seen: images.update({name: (seen.image, seen.truth)}),
    )
    assert [row["view"] for row in found.per_image] == [view.name for view in scene.test]
    expected = {}
    for row in found.per_image:
        camera, number = row["view"].split("_")
        before = images.get(f"{camera}_{int(number) - 1:04d}")
        now = images[row["view"]]
        expected[row["view"]] = before and np.abs((now[0] - now[1]) - (before[0] - before[1])).mean(dtype=np.float64)
    assert {row["view"]: row["flicker"] for row in found.per_image} == pytest.approx(expected, abs=1e-7)
    known = [value for value in expected.values() if value is not None]
    assert len(known) == 4 + 2 and found.metrics["flicker"] == pytest.approx(np.mean(known))


def test_photographs_have_no_flicker(model: Model) -> None:
    found = evaluate(model, tiny_scene(), evaluation_config(), 1)
    assert found.metrics["flicker"] is None and {row["flicker"] for row in found.per_image} == {None}
    assert "flicker" not in found.note()  # not a missing metric


def test_film_is_called_in_film_order(model: Model) -> None:
    scene, found = tiny_film(frames=3), []
    evaluate(model, scene, evaluation_config(), 2, film=lambda camera, seen: found.append((camera, seen.truth)))
    expected = {view.name: np.asarray(view.image) / np.float32(255) for view in scene.test}
    assert [camera for camera, _ in found] == ["cam00"] * 3 + ["cam05"] * 3
    assert all((truth == expected[f"test/{camera}_{i % 3:04d}"]).all() for i, (camera, truth) in enumerate(found))


def test_the_near_plane_is_in_the_scenes_unit(model: Model) -> None:
    """The cameras are at distance 4: with a near plane at 0.2 × 100 only the background is visible."""
    scene = replace(tiny_scene(), unit=100.0, background=(0.0, 1.0, 0.0))
    images: list[np.ndarray] = []
    evaluate(model, scene, evaluation_config(renders=-1), 1, lambda name, seen: images.append(seen.image))
    assert all((image == (0.0, 1.0, 0.0)).all() for image in images)


def test_renders_have_the_final_resolution_of_training(model: Model) -> None:
    cfg = evaluation_config()
    cfg = replace(cfg, train=replace(cfg.train, resolution_scale=0.5))
    sizes = []
    evaluate(model, tiny_scene(), cfg, 1, lambda name, seen: sizes.append((seen.image.shape, seen.truth.shape)))
    assert set(sizes) == {((SIZE // 2, SIZE // 2, 3),) * 2}


@pytest.mark.parametrize("renders, expected", [(0, []), (2, [0, 2]), (-1, [0, 1, 2]), (99, [0, 1, 2])])
def test_evaluate_renders_selects_the_saved_views(model: Model, renders: int, expected: list[int]) -> None:
    scene, saved = tiny_scene(), []
    evaluate(model, scene, evaluation_config(renders=renders), 1, lambda name, seen: saved.append(name))
    assert saved == [scene.test[i].name for i in expected]


def test_all_gaussians_of_a_static_model_are_alive(model: Model) -> None:
    scene = tiny_scene(static=True)
    static = initialise(scene, evaluation_config(), np.random.default_rng(0))
    found = evaluate(static, scene, evaluation_config(), 1)
    assert found.n_alive_mean == len(static)


def test_a_model_with_nan_is_refused(model: Model) -> None:
    broken = model.copy()
    broken.parameters["sh"][7, 2] = float("nan")
    with pytest.raises(ValueError, match="found NaN or Inf in sh of Gaussian 7"):
        evaluate(broken, tiny_scene(), evaluation_config(), 1)


def test_psnr_is_of_the_clamped_render() -> None:
    bright = View(tiny_scene().test[0].camera, 0.0, np.full((SIZE, SIZE, 3), 255, np.uint8), "test/r_0")
    scene = replace(tiny_scene(static=True), test=(bright,))
    model = initialise(scene, evaluation_config(), np.random.default_rng(0))
    model.parameters["sh"][:, 0] = 50.0
    model.parameters["opacity_logit"][:] = 8.0
    model.parameters["log_scale"][:] = 1.0
    images: list[np.ndarray] = []
    found = evaluate(model, scene, evaluation_config(renders=-1), 1, lambda name, seen: images.append(seen.image))
    assert images[0].max() <= 1.0
    assert found.metrics["psnr"] == pytest.approx(psnr(images[0], np.ones_like(images[0])))


def test_images_smaller_than_the_window_of_ssim_are_refused_before_training() -> None:
    scene = tiny_scene()
    refuse_small_images(scene, 11 / SIZE)
    with pytest.raises(ValueError, match="r_0: SSIM needs images of at least 11 px a side, found 10 x 10; "):
        refuse_small_images(scene, 10 / SIZE)
