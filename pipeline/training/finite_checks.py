"""Finite checks: a run stops at the first NaN or Inf in a loss, a gradient or a parameter, and names it.

A check is one pass over the values of an iteration; the search for view, field and Gaussian runs only after a failure.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from pipeline.model.model import Model
from rasterizer import Gradients


class NonFiniteError(FloatingPointError):
    """A loss, a gradient or a parameter became NaN or Inf. The last checkpoint on disk is finite."""


def check_loss(loss: float, iteration: int, view: str, model: Model) -> None:
    """After each view."""
    if not math.isfinite(loss):
        parameter = _non_finite_parameter(model)
        cause = f"NaN or Inf in {parameter}" if parameter else "the model is finite"
        raise NonFiniteError(f"iteration {iteration}, view {view}: expected a finite loss, found {loss}; {cause}")


def check_gradients(
    gradients: Gradients,
    iteration: int,
    views: Sequence[str],  # names of the batch
    gradients_of: Callable[[int], Gradients],  # index in the batch -> gradients of that view alone
    threads: int = 1,
) -> None:
    """After each batch, before the optimiser step."""
    if gradients.all_finite(threads):
        return
    for index, view in enumerate(views):
        found = first_non_finite(gradients_of(index))
        if found is not None:
            field, row = found
            raise NonFiniteError(
                f"iteration {iteration}, view {view}: expected finite gradients, "
                f"found NaN or Inf in that of {field} of Gaussian {row}"
            )
    found = first_non_finite(gradients)
    assert found is not None
    field, row = found
    raise NonFiniteError(
        f"iteration {iteration}, views {', '.join(views)}: expected finite gradients, "
        f"found NaN or Inf in the sum over the batch of {field} of Gaussian {row}"
    )


def check_model(model: Model, iteration: int) -> None:
    """Before a checkpoint is written: a model that is not finite must not replace a finite one."""
    parameter = _non_finite_parameter(model)
    if parameter is not None:
        raise NonFiniteError(
            f"iteration {iteration}: expected finite parameters, found NaN or Inf in {parameter}; "
            "not written to the checkpoint"
        )


def first_non_finite(gradients: Gradients) -> tuple[str, int] | None:
    """(field, Gaussian index) of the first NaN or Inf, or None."""
    for name, tensor in gradients.dense().items():
        row = _first_non_finite_row(tensor)
        if row is not None:
            return name, row
    for view in gradients.views:
        row = _first_non_finite_row(view.gradient)
        if row is not None:
            return "sh", int(view.visible[row])
    return None


def _non_finite_parameter(model: Model) -> str | None:
    """The first parameter that is NaN or Inf, as text, or None."""
    found = model.first_non_finite()
    if found is not None:
        return f"{found[0]} of Gaussian {found[1]}"
    if model.environment_map is not None and not torch.isfinite(model.environment_map.image).all():
        return "the environment map"
    if model.trajectories is not None and not torch.isfinite(model.trajectories.control_points).all():
        return "the trajectories"
    return None


def _first_non_finite_row(tensor: Tensor) -> int | None:
    rows = (~torch.isfinite(tensor.reshape(len(tensor), -1)).all(dim=1)).nonzero()
    return int(rows[0]) if len(rows) else None
