"""The study of clipping: its Adam clips what it says it does, and nothing else."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from builders import generator, off_centre_camera, random_gaussians

from pipeline.config.train_schema import LearningRates
from pipeline.model.model import Model
from pipeline.studies.gradient_clipping import ClippingAdam, Outcome, spike, squares_of, verdict
from pipeline.training.optimiser import Adam
from pipeline.training.schedule import learning_rates
from rasterizer import Gradients, Rasterizer, Request

RATES = learning_rates(1.0, 0.0, LearningRates(), extent=1.0)


def model_and_gradients() -> tuple[Model, Gradients]:
    """A random model, and what two views of it say."""
    g, camera = generator(31), off_centre_camera()
    gaussians = random_gaussians(300, "full", g).to(torch.float32)
    gradients, frame = Gradients.zeros_like(gaussians), Rasterizer(1)
    for time in (0.4, 0.6):
        frame.render(gaussians, Request(camera, time, 1.0))
        frame.backward(gradients, d_color=torch.randn(3, camera.height, camera.width, generator=g))
    return Model.from_gaussians(gaussians), gradients


def norm_of(gradients: Gradients) -> float:
    tensors = [*gradients.dense().values(), gradients.sh()]
    return math.sqrt(sum(t.double().square().sum().item() for t in tensors))


def test_the_whole_gradient_is_scaled_to_the_threshold() -> None:
    model, gradients = model_and_gradients()
    before, directions = norm_of(gradients), {name: t.clone() for name, t in gradients.dense().items()}
    sh = gradients.sh().clone()
    norms, hot = [], []
    ClippingAdam(model, 1, threshold=before / 4, norms=norms, hot=hot).step(gradients, RATES)
    assert norms[0]["all"] == pytest.approx(before, rel=1e-6) and 0 < hot[0] <= 1  # sums over a row in float32
    # One rounding of float32 an element, of the coefficients a few.
    for name, tensor in gradients.dense().items():
        torch.testing.assert_close(tensor, directions[name] / 4, rtol=1e-6, atol=0.0)
    torch.testing.assert_close(gradients.sh(), sh / 4, rtol=1e-5, atol=1e-6 * sh.abs().max().item())
    assert norm_of(gradients) == pytest.approx(before / 4, rel=1e-6)


def test_below_the_threshold_it_is_adam() -> None:
    (clipped, gradients), (plain, same) = model_and_gradients(), model_and_gradients()
    ClippingAdam(clipped, 1, threshold=2 * norm_of(gradients), norms=[], hot=[]).step(gradients, RATES)
    Adam(plain, 1).step(same, RATES)
    for name, tensor in plain.parameters.items():
        assert torch.equal(clipped.parameters[name], tensor), name


def test_norms_by_field_add_up() -> None:
    _, gradients = model_and_gradients()
    squares = squares_of(gradients)
    assert set(squares) == {*gradients.dense(), "sh", "all"}
    assert math.sqrt(squares["all"].sum().item()) == pytest.approx(norm_of(gradients), rel=1e-6)


def test_a_spike_is_seen_against_what_came_before() -> None:
    norms = np.concatenate([np.full(200, 8.0), np.full(200, 2.0)])
    assert spike(norms) == 1.0  # a fall is none
    norms[300] = 14.0
    assert spike(norms) == 7.0


def outcome(psnr: float) -> Outcome:
    return Outcome(psnr, {}, 0.0, 0.0)


@pytest.mark.parametrize(
    "clipped, plain, word",
    [
        ([26.0, 26.1, 26.2], [25.0, 25.1, 25.2], "better"),
        ([25.0, 25.1, 25.2], [26.0, 26.1, 26.2], "worse"),
        ([25.0, 25.1, 25.2], [25.0, 25.1, 25.2], "no difference shown"),
        ([25.0, 25.1, 25.2], [25.0, math.nan, 25.2], "better"),
        ([math.nan] * 3, [math.nan] * 3, "no difference shown"),
    ],
)
def test_verdict(clipped: list[float], plain: list[float], word: str) -> None:
    assert verdict([outcome(p) for p in clipped], [outcome(p) for p in plain])[1] == word
