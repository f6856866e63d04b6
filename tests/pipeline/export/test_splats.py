"""A frame of a model renders as the model does at that time, and so does the sum of moving Gaussians."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from builders import generator, make_request, random_gaussians
from export_readers import static_at
from scipy.integrate import quad

from pipeline.export.splats import frame_at, mean_fourier_basis, moving_gaussians
from pipeline.model.model import Model
from rasterizer import Rasterizer

TIMES = (0.0, 0.45, 0.8)


def image(model: Model, **changes) -> np.ndarray:
    return Rasterizer(threads=1).render(model.gaussians(), make_request(**changes)).color.numpy()


def model_of(motion: str, fourier_order: int = 2) -> Model:
    gaussians = random_gaussians(200, motion, generator(3), fourier_order=fourier_order)
    return Model.from_gaussians(gaussians.to(torch.float32))


@pytest.mark.parametrize("motion", ["full", "shared", "separable", "static"])
@pytest.mark.parametrize("time", TIMES)
def test_a_frame_renders_as_the_model(motion: str, time: float) -> None:
    model = model_of(motion)
    frame = frame_at(model, time, duration=0.8)
    assert frame.kind.motion == "static" and len(frame) <= len(model)
    # float32 scales and quaternions instead of M; 1e-4 of full scale is a fortieth of a level of 8 bits
    assert np.abs(image(frame, time=0.0) - image(model, time=time)).max() < 1e-4


@pytest.mark.parametrize("motion", ["full", "separable"])
def test_moving_gaussians_are_exact_without_time_varying_colour(motion: str) -> None:
    model = model_of(motion, fourier_order=0)
    moving = moving_gaussians(model, 0.0, 0.8)
    for time in TIMES:
        assert np.abs(image(static_at(moving, time), time=0.0) - image(model, time=time)).max() < 1e-4


def test_what_cannot_be_seen_is_left_out() -> None:
    model = model_of("full")
    late = model.parameters["mean"].clone()
    late[:100, 3] = 50.0  # far after the scene
    faint = model.parameters["opacity_logit"].clone()
    faint[100:120] = -8.0  # alpha 0.0003, below 1/255
    changed = Model(model.kind, model.parameters | {"mean": late, "opacity_logit": faint})
    assert len(moving_gaussians(changed, 0.0, 0.8)) <= 80
    assert np.array_equal(
        image(frame_at(changed, 0.3, 0.8)), image(frame_at(Model.from_gaussians(rows(changed, 120)), 0.3, 0.8))
    )


def rows(model: Model, first: int):
    return model.gaussians().rows(torch.arange(first, len(model)))


def test_the_mean_colour_is_the_integral() -> None:
    time, sigma, start, duration = 0.35, 0.12, 0.1, 0.8
    peak = torch.tensor([time]).double()
    found = mean_fourier_basis(peak, torch.tensor([sigma]).double(), start, start + duration, duration, 2, peak)
    reach = sigma * np.sqrt(2 * np.log(20))
    low, high = max(start, time - reach), min(start + duration, time + reach)

    def weighted(t: float, n: int) -> float:
        return np.exp(-0.5 * ((t - time) / sigma) ** 2) * np.cos(2 * np.pi * n * (t - time) / duration)

    expected = [quad(weighted, low, high, args=(n,))[0] / quad(weighted, low, high, args=(0,))[0] for n in range(3)]
    # the midpoint rule of 32 intervals is off by (h²/24) f'', h = 0.018 and f'' below 70 + 250
    assert found[0].numpy() == pytest.approx(expected, abs=5e-3)


def test_a_static_model_has_no_time() -> None:
    with pytest.raises(ValueError, match="expected a model with time, found a static one"):
        moving_gaussians(model_of("static"), 0.0, 1.0)


def test_a_thin_gaussian_keeps_its_axes() -> None:
    """Axis ratios of 1e5: of A Aᵀ in float32 the thin axis would be noise."""
    model = model_of("full")
    p = dict(model.parameters)
    p["log_scale"] = p["log_scale"].clone()
    p["log_scale"][:, 0] = np.log(1e-6)
    thin = Model(model.kind, p)
    frame = frame_at(thin, 0.4, 0.8)
    assert replace(frame.gaussians()).log_scale.amin(dim=1).max() < np.log(0.05)
    assert np.abs(image(frame) - image(thin, time=0.4)).max() < 1e-4
