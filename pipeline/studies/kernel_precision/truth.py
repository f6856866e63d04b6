"""What errors are measured against: the readable twin in float64, with any thresholds or none.

Without thresholds the twin adds up every Gaussian in front of the camera at every moment: the sum that the
cut-offs approximate. The cap α' <= 0.99, the near plane and the 0.3 px² are the model's and stay.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from rasterizer import Gaussians
from rasterizer.reference import render as reference
from rasterizer.reference.blend import Splats, Thresholds, blending_weights, pixel_centers, splat_alpha
from rasterizer.timing.workloads import Workload

# A Gaussian with α' below this at every pixel is left out, whatever the thresholds: a million of them change a pixel
# by 1e-12. It keeps the small images that errors are measured on affordable.
NEGLIGIBLE = 1e-18
PAIRS_TOGETHER = 2**20  # splats × pixels: some ten tensors of so many live at once


@dataclass(frozen=True)
class Rendered:
    """An image and what a loss with ∂L/∂image = d_color says of the parameters."""

    color: Tensor  # (3, H, W)
    gradients: dict[str, Tensor]  # by field of Gaussians, its shape


def render_reference(
    workload: Workload, d_color: Tensor, thresholds: Thresholds, dtype: torch.dtype = torch.float64
) -> Rendered:
    """The workload's view over black by the readable twin. d_color: (3, H, W).

    In bands of pixels, each carried back at once as far as the splats: the graph of a whole image need not fit in
    memory.
    """
    request, everything = workload.request(), workload.gaussians.to(dtype)
    rows = _rows_in_reach(everything, workload, thresholds)
    leaves = {name: tensor[rows].requires_grad_() for name, tensor in everything.tensors().items()}
    splats = reference.make_splats(Gaussians(**{"quat_right": None, **leaves}), request, thresholds.min_marginal)
    made = [splats.center, splats.ellipse, splats.opacity, splats.features]
    cut = [tensor.detach().requires_grad_() for tensor in made]
    detached = Splats(splats.index, *cut)
    pixels = pixel_centers(request.camera, dtype).reshape(-1, 2)
    band = max(1, PAIRS_TOGETHER // max(1, len(rows)))
    color = []
    for at, d in zip(pixels.split(band), d_color.to(dtype).flatten(1).split(band, dim=1), strict=True):
        weight, _ = blending_weights(splat_alpha(detached, at, thresholds.min_alpha), thresholds.min_transmittance)
        part = detached.features.T @ weight
        part.backward(d)
        color.append(part.detach())
    torch.autograd.backward(made, [tensor.grad for tensor in cut])
    gradients = {name: torch.zeros_like(tensor) for name, tensor in everything.tensors().items()}
    for name, leaf in leaves.items():
        if leaf.grad is not None:
            gradients[name][rows] = leaf.grad
    return Rendered(torch.cat(color, dim=1).reshape(d_color.shape), gradients)


@torch.no_grad()
def _rows_in_reach(gaussians: Gaussians, workload: Workload, thresholds: Thresholds) -> Tensor:
    """Ascending rows of the Gaussians that may reach NEGLIGIBLE somewhere in the image.

    Seen from a splat, the nearest pixel lies at least |d| away, d from its mean to the image's rectangle, and
    dᵀ Σ⁻¹ d is at least |d|² times the smaller eigenvalue of Σ⁻¹.
    """
    camera = workload.camera
    splats = reference.make_splats(gaussians, workload.request(), thresholds.min_marginal)
    size = splats.center.new_tensor([camera.width, camera.height])
    offset = splats.center - splats.center.clamp(min=torch.zeros_like(size), max=size)
    lean, across, along = splats.ellipse.unbind(-1)
    xx, xy, yy = 1 / across, lean / across, lean**2 / across + 1 / along  # of Σ⁻¹
    smaller = (0.5 * (xx + yy) - torch.hypot(0.5 * (xx - yy), xy)).clamp(min=0)
    bound = splats.opacity * torch.exp(-0.5 * smaller * (offset * offset).sum(dim=1))
    return splats.index[bound >= NEGLIGIBLE].sort().values
