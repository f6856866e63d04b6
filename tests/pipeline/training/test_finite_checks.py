"""Finite checks: a NaN or Inf stops training with its iteration, view, field and Gaussian."""

from __future__ import annotations

import numpy as np
import pytest
from tiny import tiny_config, tiny_scene, train_tiny

from pipeline.model.initialise import initialise
from pipeline.training import checkpoint, finite_checks
from pipeline.training.objective.objective import Objective
from rasterizer.loss import PhotometricLoss


def insert_nan(monkeypatch, at_call: int, row: int) -> None:
    """The view of the `at_call`-th backward pass has a NaN in the gradient of the mean from then on."""
    original, names = Objective.backward, []

    def backward(self, model, found, gradients, *rest):
        view = original(self, model, found, gradients, *rest)
        names.append(found.view.target.name)
        if names[-1] == names[min(at_call, len(names) - 1)] and len(names) > at_call:
            gradients.mean[row, 1] = float("nan")
        return view

    monkeypatch.setattr(Objective, "backward", backward)


def test_non_finite_gradient_names_iteration_view_and_gaussian(tmp_path, monkeypatch) -> None:
    insert_nan(monkeypatch, at_call=2 * 8 + 1, row=13)  # the second view of the ninth batch
    with pytest.raises(
        finite_checks.NonFiniteError, match=r"iteration 9, view train/r_\d: .* mean of Gaussian 13"
    ) as error:
        train_tiny(tmp_path)
    assert "\n" not in str(error.value)
    saved = checkpoint.load(tmp_path / checkpoint.FILE_NAME)
    assert saved.iteration == 7 and saved.model.first_non_finite() is None, "the last checkpoint is kept"


def test_non_finite_loss_names_iteration_and_view(tmp_path, monkeypatch) -> None:
    original, calls = PhotometricLoss.__call__, []

    def loss(self, image, *rest, **named):
        calls.append(1)
        return original(self, image * float("nan") if len(calls) == 6 else image, *rest, **named)

    monkeypatch.setattr(PhotometricLoss, "__call__", loss)
    with pytest.raises(
        finite_checks.NonFiniteError, match=r"iteration 3, view train/r_\d: expected a finite loss, found nan"
    ):
        train_tiny(tmp_path)


def test_a_model_with_inf_is_not_written() -> None:
    model = initialise(tiny_scene(), tiny_config(), np.random.default_rng(0))
    finite_checks.check_model(model, 5)
    model.parameters["log_scale"][17, 2] = float("inf")
    with pytest.raises(finite_checks.NonFiniteError, match="iteration 5: .* log_scale of Gaussian 17"):
        finite_checks.check_model(model, 5)
