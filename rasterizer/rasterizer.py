"""`Rasterizer`: the forward and backward pass of one view by the compiled kernel, without autograd; training uses it.

rasterizer = Rasterizer(threads=2)  # owns buffers that are reused from view to view
out = rasterizer.render(gaussians, Request(camera, time=0.5))
view = rasterizer.backward(gradients, d_color=…)  # adds to `gradients`

A batch of views has a Rasterizer each; `render_batch` reads the Gaussians once for all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from rasterizer.camera import Camera
from rasterizer.cores import thread_count
from rasterizer.gaussians import OPTIONAL, SH_LAYOUTS, Gaussians
from rasterizer.gradients import Gradients, ViewColors, ViewGradient
from rasterizer.kernel_loader import kernel
from rasterizer.request import OUTPUT_CHANNELS, RenderOutput, Request
from rasterizer.trajectories import COLUMNS, Trajectories
from rasterizer.validation import as_float, check_array, check_layout, plain

# In the order of `enum Stage` in src/view_state.hpp: four of the forward pass, two of the backward pass.
STAGES = ("preprocess", "sort", "intersect_tiles", "blend", "blend_backward", "preprocess_backward")
_EXTRAS = ("depth", "flow", "stats")  # outputs that preprocess computes per Gaussian only on request
MISSING: dict[str, Any] = dict.fromkeys(OPTIONAL)  # to the kernel, None


class Rasterizer:
    """Renders a view and keeps its state for the backward pass; the next `render` replaces it."""

    device = torch.device("cpu")

    def __init__(self, threads: int = 0, kernel: ModuleType = kernel) -> None:
        """threads: 0 for all usable cores; results are the same bits for any number.

        kernel: another build, for measurements; one in float64 reads and writes float64 tensors.
        """
        self.threads = thread_count(threads)
        self._kernel, self._state = kernel, kernel.Rasterizer()
        self.dtype = torch.float64 if kernel.choices["float64"] else torch.float32
        self._gaussians: Any = (
            None  # the Gaussians as the kernel sees them; None before the first view, or if one failed
        )
        self._differentiable = False
        self._trajectories: Trajectories | None = None

    def render(self, gaussians: Gaussians, request: Request, differentiable: bool = True) -> RenderOutput:
        """Render one view. The Gaussians must be contiguous and of the kernel's type, float32; else ValueError.

        differentiable: False skips what only `backward` needs.
        """
        return self.render_batch([self], gaussians, [request], differentiable)[0]

    @staticmethod
    def render_batch(
        rasterizers: Sequence[Rasterizer],
        gaussians: Gaussians,
        requests: Sequence[Request],
        differentiable: bool = True,
    ) -> list[RenderOutput]:
        """Render a view with each, as `render`: the same bits, but parameters are read once for all views."""
        views = zip(rasterizers, requests, strict=True)
        check_layout(gaussians, rasterizers[0].dtype)
        for rasterizer, request in views:
            rasterizer._begin(gaussians, request, differentiable)
        stored = _as_kernel_sees_them(rasterizers[0]._kernel, gaussians, requests)
        images = [rasterizer._new_images() for rasterizer in rasterizers]
        planes = [[rasterizer._images.get(name) for name in OUTPUT_CHANNELS] for rasterizer in rasterizers]
        kernel = rasterizers[0]._kernel
        kernel.render(rasterizers=[rasterizer._state for rasterizer in rasterizers], gaussians=stored, images=planes)
        for rasterizer, shown in zip(rasterizers, stored, strict=True):
            rasterizer._gaussians = shown
        return [RenderOutput(**{name: named.get(name) for name in OUTPUT_CHANNELS}) for named in images]

    def _begin(self, gaussians: Gaussians, request: Request, differentiable: bool) -> None:
        """Check and note the view to render."""
        request.check_against(gaussians)
        self._differentiable = differentiable
        self.sh_degree = gaussians.sh_degree if request.sh_degree is None else int(request.sh_degree)
        self.fourier_order = gaussians.fourier_order if request.fourier_order is None else int(request.fourier_order)
        self._gaussians = None  # should this view fail, there is nothing to go backward from
        self._shapes = {name: tensor.shape for name, tensor in gaussians.tensors().items()}
        self._request, self._trajectories = request, gaussians.trajectories
        self._set_view(request)

    def _new_images(self) -> dict[str, Tensor]:
        """Those that the view's request names, not yet written."""
        size = self._request.camera.height, self._request.camera.width
        images = {name: self._empty(OUTPUT_CHANNELS[name], *size) for name in self._request.outputs}
        # Detached: autograd's graph references this object, which must not reference the graph.
        self._images = {name: image.detach() for name, image in images.items()}
        # Under torch.inference_mode tensors have no version, and no backward pass.
        self._versions = {name: image._version for name, image in self._images.items() if not image.is_inference()}
        return images

    def _set_view(self, request: Request) -> None:
        flow_dt = _flow_dt(request)
        later = None if flow_dt is None else request.flow_camera
        self._state.set_view(
            camera=self._camera(request.camera),
            flow_camera=None if later is None else self._camera(later),
            time=request.time,
            marginal_offset=request.marginal_offset,
            duration=request.duration,
            near=request.near,
            background=list(request.background),
            flow_dt=flow_dt or 0.0,
            sh_degree=self.sh_degree,
            fourier_order=self.fourier_order,
            extras=tuple(name in request.outputs for name in _EXTRAS),
            differentiable=self._differentiable,
            detached="detached" in request.released_gradients,
            threads=self.threads,
        )

    def _camera(self, camera: Camera) -> Any:
        intrinsics = [camera.fx, camera.fy, camera.cx, camera.cy]
        return self._kernel.Camera.make(
            camera.width, camera.height, intrinsics, camera.world_to_cam, list(camera.position)
        )

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

        Follows the last `render`; neither the Gaussians nor the returned images may have changed since. Raises
        RuntimeError without such a render or when an image was changed in place, ValueError for an output that was not
        rendered, a gradient of another shape or type, or `gradients` of other Gaussians.
        """
        if self._gaussians is None or not self._differentiable:
            raise RuntimeError(
                "Rasterizer.backward must follow Rasterizer.render with differentiable=True, got no such view"
            )
        self._check_gradients(gradients)
        given = {"color": d_color, "alpha": d_alpha, "depth": d_depth, "flow": d_flow, "stats": d_stats}
        d_images = {f"d_{name}": self._checked(name, d_image) for name, d_image in given.items()}
        for name, image in self._images.items():
            if name in self._versions and image._version != self._versions[name]:
                raise RuntimeError(
                    f"Rasterizer.backward reads the rendered {name}, which was changed in place after "
                    "Rasterizer.render: clone it first"
                )
        visible = self._state.visible
        out = ViewGradient(
            torch.empty(visible, dtype=torch.int32), self._empty(visible, 2), *(self._empty(visible) for _ in range(2))
        )
        compact = self._empty(visible, 8)
        colors = ViewColors.of(self._request, out.visible, compact, self.sh_degree, self.fourier_order)
        dense = gradients.dense()
        if self._trajectories is not None:
            dense["trajectories"] = torch.zeros(len(self._trajectories), COLUMNS, dtype=self.dtype)
        self._state.backward(
            self._gaussians,
            **d_images,
            **{**MISSING, **dense},
            visible=out.visible,
            mean2d=out.mean2d,
            mean_t=out.mean_t,
            radius=out.radius,
            color_gradient=compact,
        )
        gradients.views.append(colors)
        if self._trajectories is not None and gradients.trajectories is not None:
            at = self._request.time, _flow_dt(self._request)
            self._trajectories.add_gradient(gradients.trajectories, dense["trajectories"], *at)
        return out

    def _check_gradients(self, gradients: Gradients) -> None:
        """ValueError unless `gradients` have the fields, the shapes and the type of the rendered Gaussians."""
        found = {name: tensor.shape for name, tensor in gradients.dense().items()} | {"sh": gradients.sh_shape}
        for name in self._shapes.keys() | found.keys():
            if (expected := self._shapes.get(name)) != found.get(name):
                shapes = (None if shape is None else list(shape) for shape in (expected, found.get(name)))
                raise ValueError("gradients.{} must be {}, as the rendered Gaussians, got {}".format(name, *shapes))
        for name, tensor in gradients.dense().items():
            check_array(f"gradients.{name}", tensor, self.dtype, self._shapes[name])

    def _checked(self, name: str, d_image: Tensor | None) -> Tensor | None:
        """∂L/∂image of output `name`, contiguous; ValueError if it does not fit the rendered image."""
        if d_image is None:
            return None
        if name not in self._images:
            raise ValueError(f"d_{name}: expected {name!r} among the outputs, found {tuple(self._images)}")
        check_array(f"d_{name}", d_image, self.dtype, self._images[name].shape, contiguous=False)
        return plain(d_image)

    def _empty(self, *shape: int) -> Tensor:
        return torch.empty(shape, dtype=self.dtype)

    @property
    def visible(self) -> int:
        """Number of Gaussians that reach the image of the last view."""
        return self._state.visible

    @property
    def alive(self) -> int:
        """Number of Gaussians whose temporal marginal p(t) is at least 0.05 at the last view's time + marginal_offset.

        Runs record it as `n_alive`. A static model has no marginal, so all of its Gaussians count.
        """
        return self._state.alive

    @property
    def intersections(self) -> int:
        """Number of (tile, Gaussian) intersections of the last view."""
        return self._state.intersections

    def count_pairs(self) -> tuple[int, int]:
        """(pixel, Gaussian) pairs that the last view evaluated, and those that contributed; for benchmarks."""
        return self._state.count_pairs()

    @property
    def stage_ms(self) -> dict[str, float]:
        """Wall-clock milliseconds by stage: of the last view, and of the last backward pass, which may be older."""
        return dict(zip(STAGES, self._state.stage_ms, strict=True))


def _as_kernel_sees_them(kernel: ModuleType, gaussians: Gaussians, requests: Sequence[Request]) -> list[Any]:
    """The Gaussians for each view: the same for all, unless they share trajectories, of which each has its table."""
    coefficients, orders = SH_LAYOUTS[gaussians.sh.shape[1]]
    detached: dict[str, Any] = {name: tensor.detach() for name, tensor in gaussians.tensors().items()}
    layout = {"coefficients": coefficients, "stored_order": orders - 1}
    if (trajectories := gaussians.trajectories) is None:
        return [kernel.Gaussians(**{**MISSING, **detached}, **layout)] * len(requests)
    tables = [trajectories.table(request.time, _flow_dt(request)) for request in requests]
    return [kernel.Gaussians(**{**MISSING, **detached, "trajectories": table}, **layout) for table in tables]


def _flow_dt(request: Request) -> float | None:
    """δ of the optical flow; None if it is not requested."""
    return as_float(request.flow_dt) if "flow" in request.outputs else None
