"""The estimate of a run's memory: it follows the size that is trained, not the one that is read."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import pytest
from tiny import tiny_config

from datasets.source import Size
from pipeline.config.train_schema import ResolutionStep
from pipeline.stages import estimate
from pipeline.stages.estimate import OTHER_WORK, _estimate, _iteration_seconds, workload_of
from rasterizer.bench.frame_time import Time, count_work
from rasterizer.bench.workloads import Workload, make_workload


def test_images_in_memory_have_the_size_that_is_trained(monkeypatch: pytest.MonkeyPatch) -> None:
    """At half the size a training image takes a quarter of its 12 bytes a pixel; images as read stay as they are."""
    small = make_workload("W1")
    monkeypatch.setattr(estimate, "make_workload", lambda name: small)
    size = Size(train_views=50, test_views=1, width=400, height=300)
    cfg = tiny_config(10)
    cfg = replace(cfg, train=replace(cfg.train, densify=replace(cfg.train.densify, max_gaussians=100)))
    whole = _estimate(cfg, size, 1, False)
    half = _estimate(replace(cfg, train=replace(cfg.train, resolution_scale=0.5)), size, 1, False)
    saved = 50 * 12 * 400 * 300 * (1 - 0.25)
    assert abs((whole.memory_gb - half.memory_gb) * 1e9 - saved) < 1  # both are sums of integers below 2^53


@pytest.mark.parametrize("gaussians", [300_000, 75_000])
@pytest.mark.parametrize("blended", [11.0, 40.0])
def test_as_many_gaussians_blend_into_a_pixel_as_asked(gaussians: int, blended: float) -> None:
    """The tolerance is for 0.3 squared pixels that widen every Gaussian, small ones more: 31 % at 11 of 300,000."""
    size = Size(train_views=1, test_views=0, width=676, height=507)
    found = count_work(workload_of(gaussians, size, blended))
    assert found.contributing / found.pixels == pytest.approx(blended, rel=0.35)


def test_an_iteration_is_the_mean_over_the_resolutions(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a clock that counts pixels."""

    def counted(workload: Workload, *rest: object, **options: object) -> dict[str, Time]:
        pixels = float(workload.camera.width * workload.camera.height)
        return {"iteration": Time(1e3 * pixels, 0.0)}

    monkeypatch.setattr(estimate, "time_iteration", counted)
    steps = [ResolutionStep(until=0.25, scale=0.1), ResolutionStep(until=0.5, scale=0.5)]
    cfg = tiny_config(10, resolution_steps=steps)
    size = Size(train_views=1, test_views=0, width=200, height=100)
    expected = 0.25 * 20 * 10 + 0.25 * 100 * 50 + 0.5 * 200 * 100
    seconds = partial(_iteration_seconds, size=size, gaussians=1000, blended=11, threads=1, flow=False, stored=False)
    assert seconds(cfg) == pytest.approx(OTHER_WORK * expected)
    whole = tiny_config(10, resolution_steps=[ResolutionStep(until=1.0, scale=0.5)])
    assert seconds(whole) == pytest.approx(OTHER_WORK * 100 * 50)
