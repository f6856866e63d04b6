"""What splat formats hold: the 3D Gaussians that a model is at one time, or that move on lines and fade.

Conditioned on time a 4D Gaussian is a 3D one with mean μ(t), covariance Σ(t) and opacity α p(t) (docs/method.md 1.1),
and its 4DSH is a sum of spherical harmonics with known weights (1.4). A frame is exact up to float32.

The covariance does not depend on time, the mean is linear in it, and the opacity is a Gaussian of it. Only colours that
change with time do not fit in Gaussians that move. Each has its mean colour instead, over the times at which it is
seen, weighted by p(t).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from scipy.spatial.transform import Rotation
from torch import Tensor

from pipeline.model.model import Model, ModelKind
from rasterizer.reference.blend import MIN_ALPHA, MIN_MARGINAL
from rasterizer.reference.render import MAX_LOGIT, opacity, slice_in_time
from rasterizer.reference.sh import fourier_basis

SMALLEST_SCALE = 1e-30  # in units of the scene; the logarithm of a flat axis stays finite
REACH = float(np.sqrt(-2 * np.log(MIN_MARGINAL)))  # p(t) < 0.05 further than this many σt from μt
QUADRATURE = 32  # times at which the mean colour is sampled, evenly over those at which a Gaussian is seen


def frame_at(model: Model, time: float, duration: float) -> Model:
    """A static model that renders as `model` does at `time`, without the Gaussians that cannot be seen then.

    duration: T of the Fourier series. Background models are left out: no static format has them.
    """
    if model.kind.motion == "static":
        return Model(model.kind, model.parameters)
    gaussians = model.gaussians().to(torch.float64)
    sliced = slice_in_time(gaussians, time)
    alpha = opacity(gaussians.opacity_logit) * sliced.marginal
    seen = (sliced.marginal >= MIN_MARGINAL) & (alpha >= MIN_ALPHA)
    log_scale, quat = scales_and_rotation(sliced.factor[seen])
    weights = fourier_basis(time - gaussians.mean[seen, 3], duration, model.kind.fourier_order)
    return static_model(
        sliced.mean[seen], log_scale, quat, logit(alpha[seen]), constant_colour(model, gaussians.sh[seen], weights)
    )


def static_model(mean: Tensor, log_scale: Tensor, quat: Tensor, opacity_logit: Tensor, sh: Tensor) -> Model:
    """A static model of 3D Gaussians, of any floating-point type."""
    fields = {"mean": mean, "log_scale": log_scale, "quat_left": quat, "opacity_logit": opacity_logit, "sh": sh}
    kind = ModelKind("static", 0, math.isqrt(sh.shape[1]) - 1)
    return Model(kind, {name: tensor.to(torch.float32) for name, tensor in fields.items()})


def scales_and_rotation(factor: Tensor) -> tuple[Tensor, Tensor]:
    """(log scales (N, 3), quaternions (N, 4) wxyz) of the covariances A Aᵀ, from A (N, 3, K) float64.

    The singular values of A are the scales: of A Aᵀ a thin axis would lose half of its digits.
    """
    axes, scale, _ = np.linalg.svd(factor.numpy(), full_matrices=False)
    axes[:, :, 2] *= np.linalg.det(axes)[:, None]  # a rotation, not a reflection
    quat = Rotation.from_matrix(axes).as_quat() if len(axes) else np.zeros((0, 4))
    return torch.from_numpy(np.log(np.maximum(scale, SMALLEST_SCALE))), torch.from_numpy(np.roll(quat, 1, axis=1))


def constant_colour(model: Model, sh: Tensor, weights: Tensor) -> Tensor:
    """Σ_n weight_n k_n, (N, (l+1)², 3): spherical harmonics without time, from 4DSH coefficients (N, K, 3)."""
    orders = sh.unflatten(1, (model.kind.fourier_order + 1, (model.kind.sh_degree + 1) ** 2))
    return torch.einsum("nf,nfbc->nbc", weights, orders)


def logit(alpha: Tensor) -> Tensor:
    return torch.clamp(torch.log(alpha) - torch.log1p(-alpha), -MAX_LOGIT, MAX_LOGIT)


def colours(sh: Tensor, alpha: Tensor) -> Tensor:
    """(N, 4) RGBA of degree 0 alone, in [0, 1]: for formats without spherical harmonics."""
    return torch.cat([(0.5 + sh[:, 0] / math.sqrt(4 * math.pi)).clamp(0.0, 1.0), alpha[:, None]], dim=1)


def unit_quaternions(quat: Tensor) -> Tensor:
    return F.normalize(quat.double(), dim=1)


# ---- All times ----


@dataclass(frozen=True)
class MovingGaussians:
    """N Gaussians, float64. At time t: mean + velocity (t - time), opacity × exp(-½ ((t - time)/sigma)²).

    Formats without windows in time ignore `window`."""

    mean: Tensor  # (N, 3) at `time`
    velocity: Tensor  # (N, 3) per unit of time
    log_scale: Tensor  # (N, 3)
    quat: Tensor  # (N, 4) unit, wxyz
    opacity: Tensor  # (N,) in (0, 1)
    sh: Tensor  # (N, (l+1)², 3) without time
    time: Tensor  # (N,) μt
    sigma: Tensor  # (N,) √Σtt
    window: Tensor | None = None  # (N, 2) seen from the first time until before the second; None: always
    note: str = ""  # what is approximated

    def __len__(self) -> int:
        return len(self.mean)


def moving_gaussians(model: Model, time_start: float, duration: float) -> MovingGaussians:
    """Those of a model without shared trajectories that are seen at any time of the scene. ValueError for a static
    model."""
    if model.kind.motion == "static":
        raise ValueError("expected a model with time, found a static one; export it as ply, splat, spz or glb")
    assert model.trajectories is None, "pieces.film_of has those"
    gaussians = model.gaussians().to(torch.float64)
    sliced = slice_in_time(gaussians, time_start)
    assert sliced.variance_t is not None
    time, sigma, alpha = gaussians.mean[:, 3], sliced.variance_t.sqrt(), opacity(gaussians.opacity_logit)
    nearest = time.clamp(time_start, time_start + duration)
    marginal = torch.exp(-0.5 * ((nearest - time) / sigma) ** 2)
    seen = (marginal >= MIN_MARGINAL) & (alpha * marginal >= MIN_ALPHA)
    time, sigma = time[seen], sigma[seen]
    log_scale, quat = scales_and_rotation(sliced.factor[seen])
    end = time_start + duration
    weights = mean_fourier_basis(time, sigma, time_start, end, duration, model.kind.fourier_order, time)
    return MovingGaussians(
        gaussians.mean[seen, :3],
        sliced.velocity[seen],
        log_scale,
        quat,
        alpha[seen],
        constant_colour(model, gaussians.sh[seen], weights),
        time,
        sigma,
    )


def mean_fourier_basis(
    time: Tensor, sigma: Tensor, first: float, last: float, duration: float, order: int, origin: Tensor
) -> Tensor:
    """(N, order + 1): the mean of cos(2πn (t - μt)/T) over the times t in `first` to `last` with p(t) >= 0.05, weighted
    by p(t) = exp(-½ ((t - time)/sigma)²). origin: (N,) μt."""
    first_seen, last_seen = (time - REACH * sigma).clamp_min(first), (time + REACH * sigma).clamp_max(last)
    share = (torch.arange(QUADRATURE, dtype=time.dtype) + 0.5) / QUADRATURE
    times = first_seen[:, None] + (last_seen - first_seen)[:, None] * share
    weight = torch.exp(-0.5 * ((times - time[:, None]) / sigma[:, None]) ** 2)
    basis = fourier_basis((times - origin[:, None]).flatten(), duration, order).unflatten(0, times.shape)
    return (weight[:, :, None] * basis).sum(dim=1) / weight.sum(dim=1, keepdim=True)


# ---- Axes of OpenGL, of which y and z have the other sign than in 3DGS's files (right, down, forward) ----

FLIPPED_AXES = (1.0, -1.0, -1.0)
FLIPPED_QUAT = (1.0, 1.0, -1.0, -1.0)  # wxyz of F R F, with F = diag(1, -1, -1); F R F and F R have one covariance
# Y_lm(x, -y, -z) / Y_lm(x, y, z), by the polynomials of rasterizer/reference/sh.py.
FLIPPED_SH = (1, -1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1)


def flipped(model: Model) -> Model:
    """A static model in axes rotated by 180° about x; its own inverse."""
    p = model.parameters
    signs = torch.tensor(FLIPPED_SH[: p["sh"].shape[1]], dtype=torch.float32)
    changed = {
        "mean": p["mean"] * torch.tensor(FLIPPED_AXES),
        "quat_left": p["quat_left"] * torch.tensor(FLIPPED_QUAT),
        "sh": p["sh"] * signs[:, None],
    }
    return Model(model.kind, p | changed)
