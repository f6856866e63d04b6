"""The same 4D Gaussians in other parameters: velocities, spatial covariances and lifetimes instead of 4D rotations.

A 4D covariance has ten numbers: six of the ellipsoid Σ(t) at any time, three of the velocity v and one of the lifetime
√Σtt (docs/method.md 1.1). In them nothing keeps a Gaussian from moving: a 4D rotation moves one with the scales s_x and
st with at most |s_x² - st²| / (2 s_x st), and not at all where both are equal (docs/method.md 5.6). Training has them
with `train.explicit_velocity`; all that reads a trained model gets rotations.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from pipeline.model.model import Model
from pipeline.model.transformed import rotations_of
from rasterizer.covariance import scaled_axes


def in_velocities(model: Model) -> Model:
    """The Gaussians of a "full" model, each with its velocity; any other model as it is. Up to float32."""
    if model.kind.motion != "full":
        return model
    axes = scaled_axes(model.gaussians().to(torch.float64))  # M
    space, time_row = axes[:, :3], axes[:, 3]
    lifetime = time_row.norm(dim=1)
    u = time_row / lifetime[:, None]
    along = torch.einsum("nij,nj->ni", space, u)  # Σ_xyz,t / √Σtt
    slices = space - along[:, :, None] * u[:, None, :]  # A, of Σ(t) = A Aᵀ
    directions, scale = (torch.from_numpy(part) for part in np.linalg.svd(slices.numpy(), full_matrices=False)[:2])
    p = dict(model.parameters)
    del p["quat_right"]
    p["log_scale"] = torch.cat([scale.log(), lifetime.log()[:, None]], dim=1).float()
    p["quat_left"] = _quaternions(directions)
    p["velocity"] = (along / lifetime[:, None]).float()
    return Model(replace(model.kind, motion="velocity"), p, model.sphere, model.environment_map)


def in_rotations(model: Model) -> Model:
    """The Gaussians of a "velocity" model, each with its 4D rotation; any other model as it is. Up to float32."""
    if model.kind.motion != "velocity":
        return model
    p = model.parameters | rotations_of(scaled_axes(model.gaussians().to(torch.float64)))
    del p["velocity"]
    return Model(replace(model.kind, motion="full"), p, model.sphere, model.environment_map)


def _quaternions(directions: Tensor) -> Tensor:
    """(N, 4) float32, w first, of the rotations to orthogonal axes (N, 3, 3), whose signs are free."""
    axes = directions * torch.linalg.det(directions).sign()[:, None, None]  # a rotation, not a reflection
    return torch.from_numpy(Rotation.from_matrix(axes.numpy()).as_quat(scalar_first=True)).float()
