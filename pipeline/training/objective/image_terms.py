"""The losses on the rendered outputs of a training view: photometric, optical flow, depth and sky.

To add one, write its term, enter it in `image_terms`, and give its weight a key in pipeline/config/train_schema.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from datasets.scene import Scene
from pipeline.config.train_schema import TrainConfig
from pipeline.data.depth_targets import SparseDepth
from pipeline.data.training_views import Target
from pipeline.model.render import ImageGradient, Rendered
from pipeline.training.objective.terms import DrawnView, ImageTerm
from rasterizer.loss import PhotometricLoss

FLOW_SOFTENING = 1e-3  # image widths: longer errors count by their length, shorter ones by its square
SMALLEST_DEPTH = 1e-6  # of D: below it a pixel shows nothing, and ρ is 0


class Photometric:
    """(1 - w) L1 + w (1 - SSIM) + `mse_weight` × MSE, w = 0.2. 3DGS and the paper have no MSE.

    The image is not clamped, so that pixels above 1 have a gradient.
    """

    weight = 1.0

    def __init__(self, mse_weight: float, threads: int) -> None:
        self._criterion = PhotometricLoss(mse_weight=mse_weight, threads=threads)

    def outputs(self, target: Target) -> tuple[str, ...]:
        return ("color",)

    def __call__(self, rendered: Rendered, view: DrawnView) -> ImageGradient:
        found = self._criterion(rendered.image, view.target.image, share=1.0 / view.batch)
        return ImageGradient(found.loss, image=found.d_image)


@dataclass(frozen=True)
class Flow:
    """`weight` × the error of the rendered optical flow against that measured in the images; not in the paper.

    Photometric gradients move what is there towards where it should be. They hardly tell a moving Gaussian from a row
    of Gaussians that appear one after another. Measured flow does.
    """

    weight: float

    def outputs(self, target: Target) -> tuple[str, ...]:
        if target.motion is None:
            return ()
        return ("flow",) if target.motion.camera is None else ("alpha", "flow")

    def __call__(self, rendered: Rendered, view: DrawnView) -> ImageGradient:
        motion = view.target.motion
        assert motion is not None and rendered.flow is not None
        alpha = None if motion.camera is None else rendered.alpha
        loss, gradient = flow_loss(rendered.flow, motion.flow, self.weight / view.batch, alpha)
        return ImageGradient(self.weight * loss, flow=gradient)


@dataclass(frozen=True)
class KnownDepth:
    """`weight`, which decays over the schedule, × the error of the inverse depth at pixels of known depth."""

    weight: float

    def outputs(self, target: Target) -> tuple[str, ...]:
        return () if target.depth is None else ("alpha", "depth")

    def __call__(self, rendered: Rendered, view: DrawnView) -> ImageGradient:
        assert rendered.depth is not None and rendered.alpha is not None and view.target.depth is not None
        weight = self.weight * view.phase.depth_decay
        return sparse_depth_loss(rendered.depth, rendered.alpha, view.target.depth, weight).over(view.batch)


@dataclass(frozen=True)
class Sky:
    """`weight` × the inverse depth in the sky."""

    weight: float

    def outputs(self, target: Target) -> tuple[str, ...]:
        return () if target.sky is None else ("alpha", "depth")

    def __call__(self, rendered: Rendered, view: DrawnView) -> ImageGradient:
        assert rendered.depth is not None and rendered.alpha is not None and view.target.sky is not None
        return sky_loss(rendered.depth, rendered.alpha, view.target.sky, self.weight).over(view.batch)


def image_terms(train: TrainConfig, scene: Scene, threads: int) -> list[ImageTerm]:
    """The losses of a schedule, in the order in which their gradients are added."""
    terms: list[ImageTerm] = [
        Photometric(train.mse_weight, threads),
        Flow(train.regularization.flow),
        KnownDepth(train.depth.lidar if scene.sweeps else train.depth.sfm),
        Sky(train.depth.sky_inverse),
    ]
    return [term for term in terms if term.weight > 0]


def flow_loss(flow: Tensor, measured: Tensor, weight: float, alpha: Tensor | None = None) -> tuple[float, Tensor]:
    """(loss, weight × ∂loss/∂flow (2, H, W)): the mean over all pixels of √(|error|² + ε²) - ε, in image widths.

    flow: (2, H, W), rendered, in pixels. measured: (2, H, W), in image widths; NaN where there is none, which has no
    loss. alpha: (1, H, W), of the Gaussians: rendered flow is a sum over their weights, so it is compared with as large
    a part of the measured one. None: with all of it, for cameras that stand still, whose background has no flow.
    """
    height, width = flow.shape[1:]
    error = (flow / width).sub_(measured if alpha is None else alpha * measured).nan_to_num_(nan=0.0)
    length = error.square().sum(dim=0, keepdim=True).add_(FLOW_SOFTENING**2).sqrt_()
    loss = (length - FLOW_SOFTENING).mean().item()
    return loss, error.mul_(weight / (height * width * width)).div_(length)


def inverse_depth(depth: Tensor, alpha: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """(ρ, ∂ρ/∂D, ∂ρ/∂α) of tensors of one shape: ρ = α² / D with D = Σ w z and α = Σ w.

    It is opacity times the inverse of the mean depth D / α. What is behind the Gaussians, the cube map, is at infinite
    distance and adds nothing. ρ and its gradient are finite for any opacity, where 1 / D is not.
    """
    known = depth > SMALLEST_DEPTH
    share = torch.where(known, alpha / depth.clamp_min(SMALLEST_DEPTH), 0.0)
    return alpha * share, -share * share, 2 * share


def sparse_depth_loss(depth: Tensor, alpha: Tensor, target: SparseDepth, weight: float) -> ImageGradient:
    """weight × the mean of |ρ - 1 / z| over the pixels with a known depth z. depth, alpha: (1, H, W), rendered."""
    at = target.pixel
    rho, by_depth, by_alpha = inverse_depth(depth.reshape(-1)[at], alpha.reshape(-1)[at])
    error = rho - target.inverse
    slope = torch.sign(error) * (weight / len(at))
    d_depth, d_alpha = torch.zeros_like(depth), torch.zeros_like(alpha)
    d_depth.view(-1)[at] = slope * by_depth
    d_alpha.view(-1)[at] = slope * by_alpha
    return ImageGradient(weight * error.abs().mean().item(), alpha=d_alpha, depth=d_depth)


def sky_loss(depth: Tensor, alpha: Tensor, sky: Tensor, weight: float) -> ImageGradient:
    """weight × the mean of ρ over the sky, as in the paper.

    sky: (1, H, W) in [0, 1], the share of each pixel that is sky; the mean is weighted by it.
    """
    share = sky / sky.sum().clamp_min(1.0)
    rho, by_depth, by_alpha = inverse_depth(depth, alpha)
    loss = weight * (share * rho).sum()
    return ImageGradient(loss.item(), alpha=share * (weight * by_alpha), depth=weight * share * by_depth)
