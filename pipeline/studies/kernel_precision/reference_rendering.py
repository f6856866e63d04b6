"""Ground truth of the errors: images and gradients by the float64 reference implementation, with any thresholds.

Without thresholds it sums all Gaussians in front of the camera at all times: the sum that the cut-offs approximate.
The cap α' <= 0.99, the near plane and the dilation of 0.3 px² belong to the model and stay.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from rasterizer import Gaussians
from rasterizer.bench.workloads import Workload
from rasterizer.reference import render as reference
from rasterizer.reference.blend import Splats, Thresholds, blending_weights, pixel_centers, splat_alpha

# A Gaussian with α' below this at every pixel is culled at any thresholds, to bound time and memory: a million of them
# change a pixel by 1e-12.
NEGLIGIBLE = 1e-18
PAIRS_PER_BAND = 2**20  # splats × pixels rendered at once; about ten tensors of this size are alive


@dataclass(frozen=True)
class Rendered:
    """An image, and the gradients of a loss with ∂L/∂image = d_color."""

    color: Tensor  # (3, H, W)
    gradients: dict[str, Tensor]  # by field of Gaussians, its shape


def render_reference(
    workload: Workload, d_color: Tensor, thresholds: Thresholds, dtype: torch.dtype = torch.float64
) -> Rendered:
    """The workload's view over black by the reference implementation. d_color: (3, H, W).

    Rendered in bands of pixels. Each band is differentiated to the splats at once, so that the graph of a whole image
    need not fit in memory.
    """
    request, gaussians = workload.request(), workload.gaussians.to(dtype)
    rows = _rows_above_negligible(gaussians, workload, thresholds)
    leaves = {name: tensor[rows].requires_grad_() for name, tensor in gaussians.tensors().items()}
    splats = reference.make_splats(Gaussians.from_tensors(leaves), request, thresholds.min_marginal)
    outputs = [splats.center, splats.ellipse, splats.opacity, splats.features]
    leaves_2d = [tensor.detach().requires_grad_() for tensor in outputs]
    detached = Splats(splats.index, *leaves_2d)
    pixels = pixel_centers(request.camera, dtype).reshape(-1, 2)
    band = max(1, PAIRS_PER_BAND // max(1, len(rows)))
    color = []
    for at, d in zip(pixels.split(band), d_color.to(dtype).flatten(1).split(band, dim=1), strict=True):
        weight, _ = blending_weights(splat_alpha(detached, at, thresholds.min_alpha), thresholds.min_transmittance)
        part = detached.features.T @ weight
        part.backward(d)
        color.append(part.detach())
    torch.autograd.backward(outputs, [tensor.grad for tensor in leaves_2d])
    gradients = {name: torch.zeros_like(tensor) for name, tensor in gaussians.tensors().items()}
    for name, leaf in leaves.items():
        if leaf.grad is not None:
            gradients[name][rows] = leaf.grad
    return Rendered(torch.cat(color, dim=1).reshape(d_color.shape), gradients)


@torch.no_grad()
def _rows_above_negligible(gaussians: Gaussians, workload: Workload, thresholds: Thresholds) -> Tensor:
    """Ascending rows of the Gaussians that may reach NEGLIGIBLE somewhere in the image.

    No pixel is closer to a splat's centre than |d|, where d points from it to the image's rectangle, and dᵀ Σ⁻¹ d is at
    least |d|² times the smaller eigenvalue of Σ⁻¹.
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
