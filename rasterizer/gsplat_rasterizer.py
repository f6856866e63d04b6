"""`GsplatRasterizer`: the rasterizer on a GPU, by gsplat (Ye et al., JMLR 2025).

The slice in time, shared motion and 4DSH are those of the reference implementation, in PyTorch on the device. gsplat
projects, sorts and blends the 3D Gaussians that are left: colour, depth, flow and time in one pass. Its conventions are
not all the kernel's, and its sums are in no fixed order (docs/gpu.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec

import torch
from torch import Tensor

from rasterizer.camera import Camera
from rasterizer.covariance import temporal_deviation
from rasterizer.gaussians import MAX_FOURIER_ORDER, Gaussians
from rasterizer.gradients import Gradients, ViewColors, ViewGradient
from rasterizer.reference import render as reference
from rasterizer.reference.blend import MIN_MARGINAL
from rasterizer.reference.sh import fourier_basis
from rasterizer.request import RenderOutput, Request

SMALLEST_NEAR = 1e-6  # world units: gsplat divides by the depth of all that is not nearer than the near plane


class NoGpu(ValueError):
    """One line: what is missing, and what installs it."""


def gpu() -> torch.device:
    """The device that gsplat renders on. Raises NoGpu without a GPU, gsplat, or what it is compiled with."""
    if torch.version.cuda is None:
        found = f"PyTorch {torch.__version__}, which has no CUDA"
    elif not torch.cuda.is_available():
        found = f"no GPU that PyTorch {torch.__version__} can use"
    elif find_spec("gsplat") is None:
        found = "no gsplat"
    elif find_spec("gsplat.csrc") is None and cuda_toolkit() is None:  # not compiled before it was installed
        found = "no CUDA toolkit, whose nvcc compiles gsplat when it is first used"
    else:
        return torch.device("cuda", torch.cuda.current_device())
    raise NoGpu(
        f"backend=gsplat: expected an NVIDIA GPU, PyTorch with CUDA and gsplat, found {found}; "
        "`make gpu` installs the last two (docs/gpu.md), backend=cpu needs none"
    )


def cuda_toolkit() -> str | None:
    """The folder of CUDA's compiler, as PyTorch finds it."""
    from torch.utils.cpp_extension import CUDA_HOME  # here: it searches and warns

    return CUDA_HOME


@dataclass(frozen=True)
class _View:
    """The last view, in autograd's graph. V rows, which may be in the image."""

    request: Request
    rows: Gaussians  # the graph's leaves
    index: Tensor  # (V,) rows of the rendered Gaussians
    sliced: reference.Slice
    features: Tensor  # (V, C) of reference.features
    splats: dict[str, Tensor]  # by gsplat: radii, means2d, conics, (1, V, …); undefined where radii are 0
    images: dict[str, Tensor]


class GsplatRasterizer:
    """Renders a view and keeps its graph for the backward pass; the next `render` replaces it.

    Tensors come from and stay on `device`; else as rasterizer.Rasterizer.
    """

    threads = 1  # of the CPU

    def __init__(self, device: torch.device) -> None:
        self.device = device
        self.alive = 0
        self._view: _View | None = None

    def render(self, gaussians: Gaussians, request: Request, differentiable: bool = True) -> RenderOutput:
        """Render one view. differentiable: False skips what only `backward` needs."""
        request.check_against(gaussians)
        self._view = None  # its memory is free for this one
        detached = Gaussians.from_tensors({name: t.detach() for name, t in gaussians.tensors().items()}, gaussians.span)
        index = torch.nonzero(marginal(detached, request) >= MIN_MARGINAL).squeeze(1)
        rows, self.alive = detached.rows(index), len(index)
        with torch.set_grad_enabled(differentiable):
            for name, tensor in rows.tensors().items():
                tensor.requires_grad_(differentiable and name != "sh")  # 4DSH gets its gradient from the colours
            view = _render(rows, index, request)
        self._view = view if differentiable else None
        return RenderOutput(**{"color": None, **{name: image.detach() for name, image in view.images.items()}})

    def backward(
        self,
        gradients: Gradients,
        d_color: Tensor | None = None,  # (3, H, W)
        d_alpha: Tensor | None = None,  # (1, H, W)
        d_depth: Tensor | None = None,  # (1, H, W)
        d_flow: Tensor | None = None,  # (2, H, W)
        d_stats: Tensor | None = None,  # (2, H, W)
    ) -> ViewGradient:
        """Add the parameter gradients to `gradients`, given ∂L/∂image of the rendered outputs (None: zero).

        Once after each `render`. Raises RuntimeError without one, ValueError for an output that was not rendered.
        """
        if self._view is None:
            raise RuntimeError(
                "GsplatRasterizer.backward must follow render with differentiable=True, once, got no such view"
            )
        view, self._view = self._view, None
        named = {"color": d_color, "alpha": d_alpha, "depth": d_depth, "flow": d_flow, "stats": d_stats}
        given = {name: d_image for name, d_image in named.items() if d_image is not None}
        for name in given:
            if name not in view.images:
                raise ValueError(f"d_{name}: expected {name!r} among the outputs, found {tuple(view.images)}")
        leaves = {name: tensor for name, tensor in view.rows.tensors().items() if name != "sh"}
        wanted = leaves | {"means2d": view.splats["means2d"], "features": view.features}
        found = _gradients(view.images, given, wanted)
        dense = gradients.dense()
        for name in leaves:
            if name == "trajectories":
                dense[name] += found[name]
            else:
                dense[name].index_add_(0, view.index, found[name])
        seen, colors = _view_gradient(view, found)
        gradients.views.append(colors)
        return seen


def marginal(gaussians: Gaussians, request: Request) -> Tensor:
    """p(t) (N,) of the view, as reference.slice_in_time has it."""
    if gaussians.motion == "static":
        return torch.ones_like(gaussians.opacity_logit)
    elapsed = request.time + request.marginal_offset - gaussians.mean[:, 3]
    return torch.exp(-0.5 * (elapsed / temporal_deviation(gaussians)) ** 2)


def _render(rows: Gaussians, index: Tensor, request: Request) -> _View:
    sliced = reference.slice_of(rows, request)
    opacity = reference.opacity(rows.opacity_logit) * sliced.marginal
    features = reference.features(rows, sliced, request)
    sums, alpha, splats = _rasterized(sliced, opacity, features, request.camera, request.near)
    return _View(request, rows, index, sliced, features, splats, reference.named_images(sums, 1 - alpha, request))


def _rasterized(
    sliced: reference.Slice, opacity: Tensor, features: Tensor, camera: Camera, near: float
) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
    """Blended features (C, H, W), alpha (H, W) and what gsplat knows of each splat."""
    from gsplat import rasterization  # the extra `gpu`

    mean = sliced.mean
    if len(mean) == 0:  # gsplat would launch kernels of no threads
        shapes = {"radii": (1, 0, 2), "means2d": (1, 0, 2), "conics": (1, 0, 3)}
        splats = {name: mean.new_zeros(shape) for name, shape in shapes.items()}
        size = camera.height, camera.width
        return mean.new_zeros(features.shape[1], *size), mean.new_zeros(size), splats
    if features.shape[1] == 0:  # alpha alone; gsplat blends at least one channel
        features = mean.new_zeros(len(mean), 1)
    intrinsics = [[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]]
    blended, alpha, splats = rasterization(
        means=mean,
        quats=None,
        scales=None,
        covars=sliced.factor @ sliced.factor.mT,
        opacities=opacity,
        colors=features,
        viewmats=mean.new_tensor(camera.world_to_cam)[None],
        Ks=mean.new_tensor(intrinsics)[None],
        width=camera.width,
        height=camera.height,
        near_plane=max(near, SMALLEST_NEAR),
        eps2d=reference.DILATION,
        packed=False,
    )
    return blended[0].permute(2, 0, 1), alpha[0, :, :, 0], splats


def _gradients(images: dict[str, Tensor], given: dict[str, Tensor], wanted: dict[str, Tensor]) -> dict[str, Tensor]:
    """∂L/∂`wanted` by name, from ∂L/∂image; zero where no image depends on it."""
    reached = {images[name]: d_image for name, d_image in given.items() if images[name].requires_grad}
    inputs = {name: tensor for name, tensor in wanted.items() if tensor.requires_grad} if reached else {}
    if not inputs:
        return {name: torch.zeros_like(tensor) for name, tensor in wanted.items()}
    found = torch.autograd.grad([*reached], [*inputs.values()], [*reached.values()], allow_unused=True)
    known = {name: gradient for name, gradient in zip(inputs, found) if gradient is not None}
    return {name: torch.zeros_like(tensor) for name, tensor in wanted.items() if name not in known} | known


@torch.no_grad()
def _view_gradient(view: _View, found: dict[str, Tensor]) -> tuple[ViewGradient, ViewColors]:
    """Of the Gaussians whose splats are in the image: what density control reads, and the gradient of 4DSH."""
    request, camera = view.request, view.request.camera
    seen = torch.nonzero((view.splats["radii"][0] > 0).all(dim=1)).squeeze(1)
    visible, rows = view.index[seen].to(torch.int32), view.rows.rows(seen)
    a, b, c = view.splats["conics"][0, seen].unbind(1)
    determinant = a * c - b * b  # of Σ2d⁻¹ = (a b; b c)
    variance = 0.5 * (a + c + torch.sqrt((a - c) ** 2 + 4 * b * b)) / determinant  # along the longer axis
    static = rows.motion == "static"
    gradient = ViewGradient(
        visible,
        found["means2d"][0, seen],
        torch.zeros_like(a) if static else found["mean"][seen, 3],
        3 * variance.sqrt(),
    )
    d_rgb = a.new_zeros(len(seen), 3)
    if "color" in request.outputs:  # no gradient where a channel is clamped at 0
        d_rgb = found["features"][seen, :3] * (view.features[seen, :3] > 0)
    direction = reference.viewing_direction(view.sliced, camera)[seen]
    elapsed = torch.zeros_like(a) if static else request.time - rows.mean[:, 3]
    cosines = fourier_basis(elapsed, request.duration, MAX_FOURIER_ORDER)[:, 1:]
    degree = rows.sh_degree if request.sh_degree is None else int(request.sh_degree)
    order = rows.fourier_order if request.fourier_order is None else int(request.fourier_order)
    return gradient, ViewColors.of(request, visible, torch.cat([d_rgb, direction, cosines], dim=1), degree, order)
