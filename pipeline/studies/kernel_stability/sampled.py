"""The kernel against the float64 reference at chosen pixels, which the reference alone can afford of a large image."""

from __future__ import annotations

from types import ModuleType

import torch
from torch import Tensor

from pipeline.studies.kernel_stability.instruction_sets import by_kernel
from pipeline.studies.kernel_stability.measure import full_scale, leaves_of, relative_error
from pipeline.studies.kernel_stability.scenes import generator
from rasterizer import Gaussians, RenderOutput, Request
from rasterizer.kernel_loader import kernel
from rasterizer.reference import render as reference
from rasterizer.reference.blend import MIN_MARGINAL, blending_weights, splat_alpha
from rasterizer.reference.discontinuities import smooth_at


def errors_at(
    gaussians: Gaussians,
    request: Request,
    pixels: Tensor,  # (P, 2) column, row
    min_marginal: float = MIN_MARGINAL,  # of the reference alone
    module: ModuleType = kernel,
) -> tuple[float, float, int]:
    """(image, gradient error, number of pixels compared). gaussians: float64, with values that float32 represents."""
    leaves = leaves_of(gaussians)
    splats = reference.make_splats(Gaussians.from_tensors(leaves), request, min_marginal)
    centres = pixels.to(torch.float64) + 0.5
    smooth = smooth_at(splats, centres)
    weight, transmittance = blending_weights(splat_alpha(splats, centres))
    named = reference.named_images((splats.features.T @ weight)[:, None], transmittance[None], request)
    truth = {name: image[:, 0] for name, image in named.items()}  # (C, P)
    scale = full_scale(RenderOutput(**{"color": None, **named}), request)
    rng = generator(99)
    at = {
        name: torch.randn(image.shape, generator=rng, dtype=torch.float64) * smooth / scale[name]
        for name, image in truth.items()
    }
    loss = torch.stack([(truth[name] * at[name]).sum() for name in truth]).sum()
    found = torch.autograd.grad(loss, list(leaves.values()), allow_unused=True)
    expected = {name: gradient for name, gradient in zip(leaves, found) if gradient is not None}
    columns, rows = pixels.unbind(1)
    weights = {}
    for name, values in at.items():
        image = torch.zeros(len(values), request.camera.height, request.camera.width)
        weights[name] = image.index_put_((torch.arange(len(values))[:, None], rows, columns), values.float())
    images, gradients = by_kernel(module, 1, gaussians.to(torch.float32), request, weights)
    image_error = max(
        relative_error(images[name][:, rows, columns] * smooth, exact.detach() * smooth, scale[name])
        for name, exact in truth.items()
    )
    gradient_error = max(
        relative_error(gradients[name], exact, max(exact.abs().max().item(), 1e-30)) for name, exact in expected.items()
    )
    return image_error, gradient_error, int(smooth.sum())
