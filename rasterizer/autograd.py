"""`rasterize`: the compiled kernel as a differentiable PyTorch function."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from rasterizer.camera import Camera
from rasterizer.gaussians import Gaussians
from rasterizer.gradients import Gradients
from rasterizer.kernel_loader import kernel
from rasterizer.rasterizer import Rasterizer
from rasterizer.request import OUTPUT_NAMES, RenderOutput, Request
from rasterizer.validation import check_finite, check_layout


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx, request: Request, threads: int, span: tuple[float, float], names: tuple[str, ...], *tensors: Tensor
    ) -> tuple[Tensor, ...]:
        """names: of the fields that the tensors are. span: of the trajectories."""
        gaussians = Gaussians.from_tensors(dict(zip(names, (t.detach() for t in tensors), strict=True)), span)
        rasterizer = Rasterizer(threads)
        out = rasterizer.render(gaussians, request, differentiable=any(ctx.needs_input_grad))
        ctx.rasterizer, ctx.outputs = rasterizer, tuple(request.outputs)
        ctx.names, ctx.span = names, span
        ctx.save_for_backward(*tensors)  # of which autograd refuses those that were changed in place since
        ctx.set_materialize_grads(False)
        images = {name: getattr(out, name) for name in ctx.outputs}
        _check_no_overflow(images, "with these Gaussians and this camera", rasterizer.threads)
        return tuple(images.values())

    @staticmethod
    @once_differentiable
    def backward(ctx, *image_gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        saved = dict(zip(ctx.names, ctx.saved_tensors, strict=True))
        gradients = Gradients.zeros_like(Gaussians.from_tensors(saved, ctx.span))
        threads = ctx.rasterizer.threads
        d_images = {f"d_{name}": gradient for name, gradient in zip(ctx.outputs, image_gradients, strict=True)}
        ctx.rasterizer.backward(gradients, **d_images)
        named = gradients.dense() | {"sh": gradients.sh(threads)}
        _check_no_overflow(
            {f"the gradient of {name}": tensor for name, tensor in named.items()},
            "with these Gaussians and image gradients",
            threads,
        )
        return None, None, None, None, *(named[name] for name in ctx.names)


def _check_no_overflow(tensors: dict[str, Tensor], given: str, threads: int) -> None:
    """Raise ValueError naming the first element that is not finite; the inputs were, so float32 overflowed."""
    for name, tensor in tensors.items():
        if not kernel.all_finite(array=tensor, threads=threads):
            index = torch.nonzero(~torch.isfinite(tensor))[0].tolist()
            raise ValueError(
                f"{name}{index} must be a number that float32 holds, got {tensor[tuple(index)].item()} {given}"
            )


def rasterize(
    gaussians: Gaussians,
    camera: Camera,
    time: float = 0.0,
    duration: float = 1.0,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    outputs: Sequence[str] = ("color",),
    flow_dt: float | None = None,
    near: float = 0.2,
    sh_degree: int | None = None,
    fourier_order: int | None = None,
    threads: int = 0,
    marginal_offset: float = 0.0,
    flow_camera: Camera | None = None,
    released_gradients: Sequence[str] = (),
) -> RenderOutput:
    """Render 4D Gaussians (contiguous float32) from `camera` at `time`; differentiable in all parameters.

    time, duration, flow_dt: in the unit of μt. background: RGB. outputs: names among "color", "alpha", "depth", "flow",
    "stats"; only these are computed. flow_dt: δ of the optical flow. near: near plane, world units. sh_degree,
    fourier_order: use the coefficients up to these; None: all. threads: 0 for all cores; never changes the bits.
    marginal_offset: temporal marginals are those of time + this, all else is that of time (docs/method.md 5.2).
    flow_camera: the camera at time + δ, whose motion is part of the flow then; None: it stands still.
    released_gradients: names of rasterizer.request.RELEASED_GRADIENTS, deviations of the authors' programs.

    `rasterizer.reference.rasterize` is the same function in plain PyTorch. Raises ValueError for wrong shapes or types,
    for values that are not finite or out of range, and where float32 overflows.
    """
    view = (camera, time, duration, background, outputs, flow_dt, near, sh_degree, fourier_order, marginal_offset)
    request = Request(*view, flow_camera, released_gradients)
    check_layout(gaussians)
    check_finite(gaussians)
    tensors = gaussians.tensors()
    if not torch.is_grad_enabled():  # inside `apply` it never is: what only the backward pass needs is not computed
        tensors = {name: tensor.detach() for name, tensor in tensors.items()}
    images = _Rasterize.apply(request, threads, gaussians.span, tuple(tensors), *tensors.values())
    rendered = dict(zip(request.outputs, images, strict=True))
    return RenderOutput(**{name: rendered.get(name) for name in OUTPUT_NAMES})
