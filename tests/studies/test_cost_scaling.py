"""Cost scaling: the power-law fit and the scenes that are measured. Speed itself is not tested."""

from __future__ import annotations

import csv
import io

import pytest

from pipeline.studies.cost_scaling import (
    AXES,
    Series,
    comma_separated,
    draw,
    markdown,
    measure,
    with_gaussians,
    with_length,
    with_width,
)
from rasterizer.timing.frame_time import count_work
from rasterizer.timing.workloads import make_workload


def test_fit_recovers_a_power_law() -> None:
    sizes = (100, 250, 1000, 8000)
    c, e = Series("gaussians", "frame", sizes, tuple(0.03 * n**0.7 for n in sizes)).fit()
    assert c == pytest.approx(0.03) and e == pytest.approx(0.7)


def test_fewer_gaussians_and_smaller_images_keep_the_scene() -> None:
    w1 = make_workload("W1")
    half, small = with_gaussians(w1, 50_000), with_width(w1, 100)
    assert (half.gaussians.mean == w1.gaussians.mean[:50_000]).all() and half.camera is w1.camera
    assert (small.camera.width, small.camera.height) == (100, 100)
    assert small.camera.fx == pytest.approx(w1.camera.fx / 4) and small.camera.cx == pytest.approx(50)


def test_active_gaussians_in_a_longer_video() -> None:
    w1 = with_width(make_workload("W1"), 32)
    short, long = with_gaussians(w1, 10_000), with_length(w1, 10)
    assert (long.time, long.duration) == (10 * w1.time, 10 * w1.duration)
    assert (long.gaussians.log_scale == w1.gaussians.log_scale).all()  # lifetimes stay
    # Lifetimes are log-normal, and in the short video a sixth are longer than it. Expected active fraction: a window of
    # 2 E min(0.367 exp(z/2), 0.6) in a range of 1.2 is 64 %, one of 2 E 0.367 exp(z/2) in 12 is 6.9 %.
    assert count_work(short).alive == pytest.approx(6_380, rel=0.03)  # binomial standard deviation: 0.8 %
    assert count_work(long).alive == pytest.approx(6_930, rel=0.03)


def test_all_axes_are_measured_and_written() -> None:
    series = measure(with_gaussians(with_width(make_workload("W1"), 32), 400), repeats=1, steps=2, views=1)
    assert [(s.axis, s.cost, s.sizes) for s in series] == [
        ("gaussians", "frame", (200, 400)),
        ("gaussians", "iteration", (200, 400)),
        ("pixels", "frame", (32 * 32, 64 * 64)),
        ("pixels", "iteration", (32 * 32, 64 * 64)),
        ("length", "frame", (1, 2)),
        ("length", "iteration", (1, 2)),
        ("length_alone", "frame", (1, 2)),
        ("length_alone", "iteration", (1, 2)),
        ("batch", "iteration", (1, 2)),
    ]
    assert all(ms > 0 for s in series for ms in s.milliseconds)
    assert len(list(csv.DictReader(io.StringIO(comma_separated(series))))) == 18
    assert markdown(series, "heading").count("\n| ") == 1 + len(series)
    assert draw(series, "title") == draw(series, "title") and set(AXES) == {s.axis for s in series}
