"""`rasterize`: the compiled kernel as a differentiable PyTorch function."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from rasterizer.arguments import Request, check_finite
from rasterizer.camera import Camera
from rasterizer.forward_backward import Gradients, Rasterizer, check_stored
from rasterizer.gaussians import Gaussians
from rasterizer.kernel import kernel
from rasterizer.output import OUTPUT_NAMES, RenderOutput

_FIELDS = tuple(Gaussians.__dataclass_fields__)


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx, request: Request, threads: int, *tensors: Tensor | None) -> tuple[Tensor, ...]:
        gaussians = Gaussians(*(None if t is None else t.detach() for t in tensors))
        frame = Rasterizer(threads)
        out = frame.render(gaussians, request, differentiable=any(ctx.needs_input_grad))
        ctx.frame, ctx.gaussians, ctx.names = frame, gaussians, tuple(request.outputs)
        ctx.set_materialize_grads(False)
        images = {name: getattr(out, name) for name in ctx.names}
        _check_held(images, "with these Gaussians and this camera", frame.threads)
        return tuple(images.values())

    @staticmethod
    def backward(ctx, *image_gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        gradients = Gradients.zeros_like(ctx.gaussians)
        given = {f"d_{name}": gradient for name, gradient in zip(ctx.names, image_gradients, strict=True)}
        ctx.frame.backward(gradients, **given)
        named = gradients.dense() | {"sh": gradients.sh(ctx.frame.threads)}
        _check_held(
            {f"the gradient of {name}": tensor for name, tensor in named.items()},
            "with these Gaussians and image gradients",
            ctx.frame.threads,
        )
        return None, None, *(named.get(name) for name in _FIELDS)


def _check_held(tensors: dict[str, Tensor], given: str, threads: int) -> None:
    """Raise ValueError, naming the first entry, where float32 did not hold a result: its inputs were finite."""
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
) -> RenderOutput:
    """Render 4D Gaussians (float32, contiguous) as seen by `camera` at `time`; differentiable in all of them.

    time, duration, flow_dt: in the unit of μt. background: RGB. outputs: any of "color", "alpha", "depth", "flow",
    "stats"; what is not asked for is not computed. flow_dt: δ of the flow. near: near plane, world units.
    sh_degree, fourier_order: leave out the coefficients above them. threads: 0 for all; the result is the same bits.

    `rasterizer.reference.render.rasterize` is the same function in plain PyTorch. Raises ValueError for wrong shapes, types
    and values that are not finite.
    """
    request = Request(camera, time, duration, background, outputs, flow_dt, near, sh_degree, fourier_order)
    check_stored(gaussians)
    check_finite(gaussians)
    images = _Rasterize.apply(request, threads, *(getattr(gaussians, name) for name in _FIELDS))
    rendered = dict(zip(request.outputs, images, strict=True))
    return RenderOutput(**{name: rendered.get(name) for name in OUTPUT_NAMES})
