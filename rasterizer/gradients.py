"""Gradients of the Gaussians' parameters: the sum over a batch (`Gradients`), and one view's part (`ViewGradient`)."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from rasterizer import on_device
from rasterizer.camera import Camera
from rasterizer.cores import thread_count
from rasterizer.gaussians import SH_LAYOUTS, Gaussians
from rasterizer.kernel_loader import kernel
from rasterizer.request import Request
from rasterizer.validation import check_array


@dataclass(frozen=True)
class ViewColors:
    """Colour gradients of one view, compact: row v's SH gradient is an outer product of row v's eight numbers."""

    visible: Tensor  # (V,) int32, ascending rows of the Gaussians
    gradient: Tensor  # (V, 8): ∂L/∂rgb, unit viewing direction, cos(2πn (t-μt)/T) for n = 1, 2
    sh_degree: int
    fourier_order: int
    wrong_line: bool = False  # of Request.released_gradients

    @classmethod
    def of(cls, request: Request, visible: Tensor, gradient: Tensor, sh_degree: int, fourier_order: int) -> ViewColors:
        """As the request wants them."""
        order = 0 if "untrained" in request.released_gradients else fourier_order
        return cls(visible, gradient, sh_degree, order, "wrong_line" in request.released_gradients)

    def as_tuple(self) -> tuple[Tensor, Tensor, int, int, bool]:
        return self.visible, self.gradient, self.sh_degree, self.fourier_order, self.wrong_line


@dataclass(frozen=True)
class ViewGradient:
    """Gradients and sizes of the Gaussians visible in one view; densification reads them."""

    visible: Tensor  # (V,) int32, ascending rows of the Gaussians
    mean2d: Tensor  # (V, 2) ∂L/∂(projected mean), per pixel
    mean_t: Tensor  # (V,) ∂L/∂μt
    radius: Tensor  # (V,) 3 standard deviations along the longer axis of the projected ellipse, pixels

    def mark_visible(self, mask: Tensor, threads: int = 1) -> None:
        """Set `mask` (N,) uint8 to 1 in place for the visible Gaussians; other entries stay."""
        if on_device.is_on_device(mask):
            mask[self.visible.long()] = 1
            return
        self._check(len(mask), torch.uint8, mask=mask)
        kernel.mark_visible(visible=self.visible, mask=mask, threads=thread_count(threads))

    def accumulate(
        self, space: Tensor, time: Tensor, views: Tensor, camera: Camera, duration: float, threads: int = 1
    ) -> None:
        """Add this view to running densification statistics, (N,) float32 each, in place.

        space: Σ |∂L/∂(projected mean)| in normalized device coordinates. time: Σ |∂L/∂μt| times the duration.
        views: number of views.
        """
        if on_device.is_on_device(space):
            seen = self.visible, self.mean2d, self.mean_t
            on_device.accumulate(seen, (space, time, views), camera, duration)
            return
        self._check(len(space), torch.float32, space=space, time=time, views=views)
        kernel.accumulate(
            visible=self.visible,
            mean2d=self.mean2d,
            mean_t=self.mean_t,
            half_width=0.5 * camera.width,
            half_height=0.5 * camera.height,
            duration=duration,
            space=space,
            time=time,
            views=views,
            threads=thread_count(threads),
        )

    def _check(self, count: int, dtype: torch.dtype, **arrays: Tensor) -> None:
        """ValueError unless all arrays are of one length that has the visible rows."""
        least = int(self.visible[-1]) + 1 if len(self.visible) else 0
        if count < least:
            raise ValueError(f"{next(iter(arrays))} must have a row for each of {least} Gaussians or more, got {count}")
        for name, array in arrays.items():
            check_array(name, array, dtype, [count])


@dataclass
class Gradients:
    """Gradients of the parameters, summed over the views of a batch; SH gradients stay compact, one entry per view."""

    mean: Tensor  # of the fields of `Gaussians`, each of its shape
    log_scale: Tensor
    quat_left: Tensor
    opacity_logit: Tensor
    sh_shape: torch.Size
    quat_right: Tensor | None = None
    velocity: Tensor | None = None
    weights: Tensor | None = None
    trajectories: Tensor | None = None  # of the control points
    views: list[ViewColors] = field(default_factory=list)

    @classmethod
    def zeros_like(cls, gaussians: Gaussians) -> Gradients:
        dense: dict[str, Any] = {
            name: torch.zeros_like(tensor) for name, tensor in gaussians.tensors().items() if name != "sh"
        }
        return cls(**dense, sh_shape=gaussians.sh.shape)

    def dense(self) -> dict[str, Tensor]:
        """All gradients except SH, by parameter name."""
        return {name: tensor for name, tensor in vars(self).items() if isinstance(tensor, Tensor)}

    def zero_(self, threads: int = 1, kernel: ModuleType = kernel) -> None:
        """Reset to zero in place. kernel: a build that computes in the gradients' floating-point type."""
        if on_device.is_on_device(self.mean):
            torch._foreach_zero_(list(self.dense().values()))
        else:
            kernel.set_to_zero(arrays=list(self.dense().values()), threads=thread_count(threads))
        self.views.clear()

    def all_finite(self, threads: int = 1) -> bool:
        """Whether no gradient, SH included, is NaN or infinite."""
        tensors = [*self.dense().values(), *(view.gradient for view in self.views)]
        if on_device.is_on_device(self.mean):
            return on_device.all_finite(tensors)
        threads = thread_count(threads)
        return all(kernel.all_finite(array=tensor, threads=threads) for tensor in tensors)

    def sh(self, threads: int = 1, out: Tensor | None = None, kernel: ModuleType = kernel) -> Tensor:
        """The dense SH gradient (N, (n+1)(l+1)², 3), written into `out` if given; training uses the compact one.

        kernel: the build that rendered the views.
        """
        coefficients, orders = SH_LAYOUTS[self.sh_shape[1]]
        out = self.mean.new_empty(self.sh_shape) if out is None else out
        if on_device.is_on_device(out):
            return on_device.sh_gradient([view.as_tuple() for view in self.views], out)
        check_array("out", out, self.mean.dtype, self.sh_shape)
        kernel.expand_sh(
            views=[view.as_tuple() for view in self.views],
            dense=out,
            coefficients=coefficients,
            orders=orders,
            threads=thread_count(threads),
        )
        return out
