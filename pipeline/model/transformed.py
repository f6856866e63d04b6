"""The same Gaussians in other coordinates or parameters.

Coordinates: lengths and times scaled, origins moved (datasets/canonical.py). Where lengths and times are scaled by
different factors, Σ' = D Σ D with D = diag(s, s, s, s_t) has other axes than Σ: they are the left singular vectors of
D M, a 4D rotation, which two unit quaternions represent.

Parameters: velocities instead of 4D rotations.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from datasets.canonical import Canonical
from pipeline.model.model import CPU, Model
from rasterizer.covariance import rotation_4d, scaled_axes
from rasterizer.trajectories import Trajectories


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
    moved = model.with_parameters(p)
    if model.trajectories is not None:
        points = model.trajectories.control_points.clone()
        points[:, :, :3] *= canonical.scale
        start, end = ((time - canonical.time_origin) * canonical.time_scale for time in model.trajectories.span)
        moved.trajectories = Trajectories(points, (start, end))
    return moved


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


# ---- Velocities instead of 4D rotations -------------------------------------------------------------------------
#
# A 4D covariance has ten numbers: six of the ellipsoid Σ(t) at any time, three of the velocity v and one of the
# temporal scale √Σtt (docs/method.md 1.1). In them nothing keeps a Gaussian from moving: a 4D rotation moves one with
# the scales s_x and st with at most |s_x² - st²| / (2 s_x st), and not at all where both are equal. Training has them
# with `train.motion` velocities, tracks and trajectories; all that reads a trained model gets rotations.


def in_velocities(model: Model) -> Model:
    """The Gaussians of a "full" model, each with its velocity; any other model as it is. Up to float32."""
    if model.kind.motion != "full":
        return model
    axes = scaled_axes(model.gaussians().to(torch.float64))  # M
    space, time_row = axes[:, :3], axes[:, 3]
    deviation = time_row.norm(dim=1)  # √Σtt
    u = time_row / deviation[:, None]
    along = torch.einsum("nij,nj->ni", space, u)  # Σ_xyz,t / √Σtt
    slices = space - along[:, :, None] * u[:, None, :]  # A, of Σ(t) = A Aᵀ
    directions, scale = (torch.from_numpy(part) for part in np.linalg.svd(slices.numpy(), full_matrices=False)[:2])
    p = dict(model.parameters)
    del p["quat_right"]
    p["log_scale"] = torch.cat([scale.log(), deviation.log()[:, None]], dim=1).float()
    p["quat_left"] = _quaternions(directions)
    p["velocity"] = (along / deviation[:, None]).float()
    return model.with_parameters(p, "velocity")


def in_rotations(model: Model) -> Model:
    """The Gaussians of a "velocity" model, each with its 4D rotation; any other model as it is, and one with shared
    trajectories, which turn Gaussians in space. Up to float32. On the CPU."""
    model = model.to(CPU)
    if model.kind.motion != "velocity" or model.kind.trajectories:
        return model
    p = model.parameters | rotations_of(scaled_axes(model.gaussians().to(torch.float64)))
    del p["velocity"]
    return model.with_parameters(p, "full")


def _quaternions(directions: Tensor) -> Tensor:
    """(N, 4) float32, w first, of the rotations to orthogonal axes (N, 3, 3), whose signs are free."""
    axes = directions * torch.linalg.det(directions).sign()[:, None, None]  # a rotation, not a reflection
    return torch.from_numpy(Rotation.from_matrix(axes.numpy()).as_quat(scalar_first=True)).float()
