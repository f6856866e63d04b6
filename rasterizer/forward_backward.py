"""One view rendered by the compiled kernel, and its backward pass, without autograd: what training runs on.

rasterizer = Rasterizer(threads=2)                 # scratch memory, reused from view to view
out = rasterizer.render(gaussians, Request(camera, time=0.5))
view = rasterizer.backward(gradients, d_color=…)   # adds to `gradients`
"""

from __future__ import annotations

from dataclasses import dataclass, field
from types import ModuleType

import torch
from torch import Tensor

from rasterizer.arguments import Request
from rasterizer.camera import Camera
from rasterizer.cores import thread_count
from rasterizer.gaussians import Gaussians
from rasterizer.kernel import kernel
from rasterizer.number import is_whole, shown
from rasterizer.output import RenderOutput

STAGES = ("preprocess", "sort", "intersect_tiles", "blend", "blend_backward", "preprocess_backward")
_EXTRAS = ("depth", "flow", "stats")
MOST_THREADS = 1024  # each has a stack and a share of the lists
_CHANNELS = {"color": 3, "alpha": 1, "depth": 1, "flow": 2, "stats": 2}


@dataclass(frozen=True)
class ViewColors:
    """The colour gradient one view left: the SH gradient of its visible Gaussian v is an outer product of row v."""

    visible: Tensor  # (V,) int32, ascending ids
    gradient: Tensor  # (V, 8): ∂L/∂rgb, unit direction, cos(2πn (t-μt)/T) for n = 1, 2
    sh_degree: int
    fourier_order: int

    def as_tuple(self) -> tuple[Tensor, Tensor, int, int]:
        return self.visible, self.gradient, self.sh_degree, self.fourier_order


@dataclass(frozen=True)
class ViewGradient:
    """What one view says of the Gaussians it shows; densification reads it."""

    visible: Tensor  # (V,) int32, ascending ids
    mean2d: Tensor  # (V, 2) ∂L/∂ the mean's position in pixels
    mean_t: Tensor  # (V,) ∂L/∂μt
    radius: Tensor  # (V,) 3 standard deviations on the screen, pixels

    def mark(self, seen: Tensor, threads: int = 1) -> None:
        """Set `seen` (N,) uint8 to 1 for the Gaussians it shows."""
        kernel.mark_seen(id=self.visible, seen=seen, threads=threads)

    def add_to(
        self,
        space: Tensor,
        time: Tensor,
        views: Tensor,
        radius: Tensor,
        camera: Camera,
        duration: float,
        threads: int = 1,
    ) -> None:
        """Add to running statistics, (N,) each, in place: Σ |∂L/∂ position| in normalised device coordinates,
        Σ |∂L/∂μt| per duration, how many views, and the largest radius."""
        kernel.add_view(
            id=self.visible,
            mean2d=self.mean2d,
            mean_t=self.mean_t,
            radius=self.radius,
            half_width=0.5 * camera.width,
            half_height=0.5 * camera.height,
            duration=duration,
            space=space,
            time=time,
            views=views,
            largest_radius=radius,
            threads=threads,
        )


@dataclass
class Gradients:
    """Gradients of the parameters, summed over the views of a batch. SH gradients stay compact, a view an entry."""

    mean: Tensor  # (N, 4), static (N, 3)
    log_scale: Tensor
    quat_left: Tensor  # (N, 4)
    quat_right: Tensor | None
    opacity_logit: Tensor  # (N,)
    views: list[ViewColors] = field(default_factory=list)
    sh_shape: torch.Size | None = None

    @classmethod
    def zeros_like(cls, gaussians: Gaussians) -> Gradients:
        dense = {name: torch.zeros_like(tensor) for name, tensor in gaussians.tensors().items() if name != "sh"}
        return cls(**{"quat_right": None, **dense}, sh_shape=gaussians.sh.shape)

    def dense(self) -> dict[str, Tensor]:
        """All gradients but the SH's, by name."""
        names = ("mean", "log_scale", "quat_left", "quat_right", "opacity_logit")
        named = {name: getattr(self, name) for name in names}
        return {name: tensor for name, tensor in named.items() if tensor is not None}

    def zero_(self, threads: int = 1, kernel: ModuleType = kernel) -> None:
        """kernel: a build of it that computes in the type of the gradients."""
        kernel.set_to_zero(arrays=list(self.dense().values()), threads=threads)
        self.views.clear()

    def all_finite(self, threads: int = 1) -> bool:
        """Neither NaN nor infinity among them, those of the SH included."""
        tensors = [*self.dense().values(), *(view.gradient for view in self.views)]
        return all(kernel.all_finite(array=tensor, threads=threads) for tensor in tensors)

    def sh(self, threads: int = 1, out: Tensor | None = None, kernel: ModuleType = kernel) -> Tensor:
        """The SH gradient, dense (N, (n+1)(l+1)², 3), into `out` if given. Training never asks for it.

        kernel: the build of it that the views come from.
        """
        count, orders = split_coefficients(self.sh_shape[1])
        out = torch.empty(self.sh_shape, dtype=self.mean.dtype) if out is None else out
        kernel.expand_sh(
            views=[view.as_tuple() for view in self.views],
            dense=out,
            coefficients=count,
            orders=orders,
            threads=threads,
        )
        return out


def split_coefficients(total: int) -> tuple[int, int]:
    """((l+1)², Fourier orders) of (n+1)(l+1)² stored coefficients."""
    for per_order in (16, 9, 4, 1):
        if total % per_order == 0:
            return per_order, total // per_order
    raise ValueError(f"sh must hold (n+1)(l+1)² coefficients, got {total}")


def _type_name(dtype: torch.dtype) -> str:
    return str(dtype).removeprefix("torch.")


def check_stored(gaussians: Gaussians, dtype: torch.dtype = torch.float32) -> None:
    """Raise ValueError for the first tensor that is not contiguous and of that type."""
    for name, tensor in gaussians.tensors().items():
        plain = tensor.device.type == "cpu" and tensor.layout == torch.strided and not tensor.is_neg()
        if tensor.dtype != dtype or not plain or not tensor.is_contiguous():
            kind, shape = _type_name(tensor.dtype), list(tensor.shape)
            if not plain:
                kind += f", {'negated' if tensor.layout == torch.strided else tensor.layout} on {tensor.device},"
            elif not tensor.is_contiguous():
                kind += ", not contiguous,"
            raise ValueError(f"{name} must be contiguous {_type_name(dtype)} {shape}, got {kind} {shape}")


class Rasterizer:
    """Scratch memory of a view between its forward and its backward pass."""

    def __init__(self, threads: int = 0, kernel: ModuleType = kernel) -> None:
        """threads: 0 for as many as the process may use. Results are the same bits for any number.

        kernel: another build of it, for measurements. One in float64 takes and gives tensors of that type.
        """
        if not is_whole(threads, 0, MOST_THREADS):
            raise ValueError(f"threads must be in 0..{MOST_THREADS}, got {shown(threads)}")
        self.threads = thread_count(int(threads))
        self._kernel, self._frame = kernel, kernel.Frame()
        self.dtype = torch.float64 if kernel.choices["float64"] else torch.float32
        self._model = self._request = None
        self._differentiable = False

    def render(self, gaussians: Gaussians, request: Request, differentiable: bool = True) -> RenderOutput:
        """Render one view of contiguous Gaussians of the kernel's type, float32. Raises ValueError when they are not.

        differentiable: False leaves out what only `backward` needs.
        """
        check_stored(gaussians, self.dtype)
        request.check_against(gaussians)
        camera = request.camera
        intrinsics = [camera.fx, camera.fy, camera.cx, camera.cy]
        self._gaussians, self._request, self._differentiable = gaussians, request, differentiable
        self.sh_degree = gaussians.sh_degree if request.sh_degree is None else int(request.sh_degree)
        self.fourier_order = gaussians.fourier_order if request.fourier_order is None else int(request.fourier_order)
        coefficients, orders = split_coefficients(gaussians.sh.shape[1])
        detached = {name: tensor.detach() for name, tensor in gaussians.tensors().items()}
        self._model = self._kernel.Model(
            **{"quat_right": None, **detached}, coefficients=coefficients, stored_order=orders - 1
        )
        self._frame.set_view(
            camera=self._kernel.Camera.make(
                camera.width, camera.height, intrinsics, camera.world_to_cam, list(camera.position)
            ),
            time=request.time,
            duration=request.duration,
            near=request.near,
            background=list(request.background),
            flow_dt=float(request.flow_dt) if "flow" in request.outputs else 0.0,
            sh_degree=self.sh_degree,
            fourier_order=self.fourier_order,
            extras=tuple(name in request.outputs for name in _EXTRAS),
            differentiable=differentiable,
            threads=self.threads,
        )
        images = {name: self._empty(_CHANNELS[name], camera.height, camera.width) for name in request.outputs}
        # Detached: an image's graph holds this object, which must not hold the graph.
        self._images = {name: image.detach() for name, image in images.items()}
        self._versions = {name: image._version for name, image in self._images.items()}
        self._frame.render(self._model, **{name: self._images.get(name) for name in _CHANNELS})
        return RenderOutput(**{name: images.get(name) for name in _CHANNELS})

    def backward(
        self,
        gradients: Gradients,
        d_color: Tensor | None = None,  # (3, H, W)
        d_alpha: Tensor | None = None,  # (1, H, W)
        d_depth: Tensor | None = None,  # (1, H, W)
        d_flow: Tensor | None = None,  # (2, H, W)
        d_stats: Tensor | None = None,  # (2, H, W)
    ) -> ViewGradient:
        """Carry image gradients (shapes of the outputs; None: zero) back to the parameters, adding to `gradients`.

        Follows the last `render`; neither the Gaussians nor the images it returned may have changed since. Raises
        RuntimeError when an image has.
        """
        if self._model is None or not self._differentiable:
            raise RuntimeError(
                "Rasterizer.backward must follow Rasterizer.render with differentiable=True, got no such view"
            )
        images = {"color": d_color, "alpha": d_alpha, "depth": d_depth, "flow": d_flow, "stats": d_stats}
        size = [self._request.camera.height, self._request.camera.width]
        for name, image in images.items():
            if image is None:
                continue
            if name not in self._images:
                raise ValueError(f"d_{name}: expected {name!r} among the outputs, found {self._request.outputs}")
            if image.dtype != self.dtype or list(image.shape) != [_CHANNELS[name], *size]:
                raise ValueError(
                    f"d_{name} must be {_type_name(self.dtype)} {[_CHANNELS[name], *size]}, got "
                    f"{_type_name(image.dtype)} {list(image.shape)}"
                )
            images[name] = image.detach().contiguous()
        for name, image in self._images.items():
            if image._version != self._versions[name]:
                raise RuntimeError(
                    f"Rasterizer.backward reads the rendered {name}, which was changed in place after "
                    "Rasterizer.render: clone it first"
                )
        visible = self._frame.visible
        out = ViewGradient(
            torch.empty(visible, dtype=torch.int32), self._empty(visible, 2), self._empty(visible), self._empty(visible)
        )
        colors = ViewColors(out.visible, self._empty(visible, 8), self.sh_degree, self.fourier_order)
        self._frame.backward(
            self._model,
            **{f"d_{name}": image for name, image in images.items()},
            **{"quat_right": None, **gradients.dense()},
            id=out.visible,
            mean2d=out.mean2d,
            mean_t=out.mean_t,
            radius=out.radius,
            color_gradient=colors.gradient,
        )
        gradients.views.append(colors)
        return out

    def _empty(self, *shape: int) -> Tensor:
        return torch.empty(shape, dtype=self.dtype)

    @property
    def visible(self) -> int:
        """How many Gaussians reach the image of the last view."""
        return self._frame.visible

    @property
    def alive(self) -> int:
        """How many have p(t) >= 0.05 in the last view."""
        return self._frame.in_time

    @property
    def entries(self) -> int:
        """How many (tile, Gaussian) entries the last view made."""
        return self._frame.entries

    def count_pairs(self) -> tuple[int, int]:
        """(pixel, Gaussian) pairs the last view evaluated, and those of them that count; for the benchmark."""
        return self._frame.count_pixel_gaussian_pairs()

    @property
    def stage_ms(self) -> dict[str, float]:
        """Wall milliseconds of the last view's stages."""
        return dict(zip(STAGES, self._frame.stage_ms, strict=True))
