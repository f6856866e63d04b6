"""A model in other coordinates: lengths and times scaled, origins moved (datasets/canonical.py).

Where lengths and times are scaled by different factors, Σ' = D Σ D with D = diag(s, s, s, s_t) has other axes than Σ:
they are the left singular vectors of D M, a 4D rotation, which two unit quaternions represent.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from datasets.canonical import Canonical
from pipeline.model.model import Model
from rasterizer.covariance import rotation_4d, scaled_axes


def in_canonical(model: Model, canonical: Canonical) -> Model:
    """A model of a data set's own coordinates, in canonical ones; with `canonical.inverse` the other way.

    Renders from transformed cameras at transformed times are the same up to float32. An environment map, which is
    infinitely far away, stays.
    """
    if canonical.is_identity:
        return model
    p = dict(model.parameters)
    mean = torch.from_numpy(canonical.points(p["mean"][:, :3].numpy()))
    scales = torch.tensor([canonical.scale] * 3 + [canonical.time_scale] * (model.kind.dims - 3), dtype=torch.float64)
    if model.kind.dims == 4:
        time = (p["mean"][:, 3:].double() - canonical.time_origin) * canonical.time_scale
        mean = torch.cat([mean, time], dim=1)
    p["mean"] = mean.to(torch.float32)
    if model.kind.motion == "full" and canonical.scale != canonical.time_scale:
        p |= rotations_of(scales[:, None] * scaled_axes(model.gaussians().to(torch.float64)))
    else:
        p["log_scale"] = (p["log_scale"].double() + scales.log()).to(torch.float32)
    if model.kind.motion == "velocity":
        p["velocity"] = (p["velocity"].double() * (canonical.scale / canonical.time_scale)).to(torch.float32)
    return Model(model.kind, p, model.sphere, model.environment_map)


def rotations_of(factor: Tensor) -> dict[str, Tensor]:
    """log_scale, quat_left and quat_right (N, 4) of the covariances F Fᵀ, from F (N, 4, 4) float64.

    The last axis is the one nearest to the time axis, as where nothing moves: training takes its scale for the temporal
    one.
    """
    axes, scale, _ = np.linalg.svd(factor.numpy())
    order = np.argsort(np.arange(4) == np.abs(axes[:, 3]).argmax(axis=1)[:, None], axis=1, kind="stable")
    axes, scale = np.take_along_axis(axes, order[:, None], axis=2), np.take_along_axis(scale, order, axis=1)
    axes[:, :, 3] *= np.linalg.det(axes)[:, None]  # a rotation, not a reflection
    left, right = quaternions_of(torch.from_numpy(axes))
    found = {"log_scale": torch.from_numpy(np.log(scale)), "quat_left": left, "quat_right": right}
    return {name: tensor.to(torch.float32) for name, tensor in found.items()}


def quaternions_of(rotation: Tensor) -> tuple[Tensor, Tensor]:
    """Unit ql, qr (N, 4) with L(ql) R(qr) = `rotation` (N, 4, 4), which has determinant 1.

    The 16 products L(e_a) R(e_b) of basis quaternions are orthogonal, of squared norm 4. The coefficients in them are
    therefore c_ab = ql_a qr_b, of which the largest row is a multiple of qr and the largest column one of ql.
    """
    basis = torch.eye(4, dtype=rotation.dtype)
    products = rotation_4d(basis.repeat_interleave(4, dim=0), basis.repeat(4, 1)).unflatten(0, (4, 4))
    coefficients = torch.einsum("nij,abij->nab", rotation, products) / 4
    largest = coefficients.square().sum(dim=2).argmax(dim=1)
    row = coefficients[torch.arange(len(rotation)), largest]
    right = torch.nn.functional.normalize(row, dim=1)
    left = torch.nn.functional.normalize(torch.einsum("nab,nb->na", coefficients, right), dim=1)
    return left, right
