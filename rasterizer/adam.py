"""Fused Adam in C++: one pass over parameter, gradient and both moments, with torch.optim.Adam's arithmetic."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from rasterizer.cores import thread_count
from rasterizer.gaussians import SH_LAYOUTS
from rasterizer.gradients import Gradients
from rasterizer.kernel_loader import kernel
from rasterizer.validation import dtype_name


def adam_step(
    param: Tensor,
    grad: Tensor,
    m: Tensor,
    v: Tensor,
    lr: float | Sequence[float],
    step: int,
    beta1: float = 0.9,
    beta2: float = 0.999,
    eps: float = 1e-15,
    sparse_rows: Tensor | None = None,
    threads: int = 0,
) -> None:
    """Update `param` (N,) or (N, C) and its moments m, v in place; all contiguous float32.

    lr: one learning rate, or one per column. step: counts from 1. sparse_rows (N,) uint8: rows with 0 are skipped,
    moments included (dense Adam would still move them by their momentum). ValueError for tensors that are not
    contiguous float32 of one shape, a wrong number of rates or rows, and a step below 1.
    """
    _check(param.shape, param=param, grad=grad, m=m, v=v)
    if param.ndim not in (1, 2):
        raise ValueError(f"param must be (N,) or (N, C), got {list(param.shape)}")
    _check_rows(sparse_rows, len(param), step)
    columns = param.shape[1] if param.ndim == 2 else 1
    rates = [float(lr)] * columns if isinstance(lr, (int, float)) else [float(rate) for rate in lr]
    if len(rates) != columns:
        raise ValueError(f"lr must hold one rate or one for each of {columns} columns, got {len(rates)}")
    kernel.adam(
        p=param,
        g=grad,
        m=m,
        v=v,
        lr=rates,
        keep=sparse_rows,
        beta1=beta1,
        beta2=beta2,
        epsilon=eps,
        step=step,
        threads=thread_count(threads),
    )


def sh_adam_step(
    sh: Tensor,
    gradients: Gradients,
    m: Tensor,
    v: Tensor,
    lr: Sequence[float],
    step: int,
    beta1: float = 0.9,
    beta2: float = 0.999,
    eps: float = 1e-15,
    sparse_rows: Tensor | None = None,
    threads: int = 0,
) -> None:
    """Update SH coefficients (N, K, 3) and their moments in place from the compact gradients of a batch.

    Degrees and Fourier orders that no view of the batch used are skipped, which is exact as long as they never had a
    gradient. lr: four learning rates: of the constant coefficient; of those that depend on the viewing direction; on
    time; on both. sparse_rows, errors: as in `adam_step`.
    """
    if sh.ndim != 3 or sh.shape[1] not in SH_LAYOUTS or sh.shape[2] != 3:
        raise ValueError(f"sh must be (N, K, 3) with K among {', '.join(map(str, SH_LAYOUTS))}, got {list(sh.shape)}")
    _check(gradients.sh_shape, sh=sh, m=m, v=v)
    _check_rows(sparse_rows, len(sh), step)
    if len(lr) != 4:
        raise ValueError(f"lr must hold four rates, got {len(lr)}")
    coefficients, orders = SH_LAYOUTS[sh.shape[1]]
    used_orders = 1 + max((view.fourier_order for view in gradients.views), default=0)
    used_coefficients = (1 + max((view.sh_degree for view in gradients.views), default=0)) ** 2
    kernel.adam_sh(
        sh=sh,
        m=m,
        v=v,
        coefficients=coefficients,
        orders=orders,
        active_coefficients=min(used_coefficients, coefficients),
        active_orders=min(used_orders, orders),
        lr=[float(rate) for rate in lr],
        keep=sparse_rows,
        views=[view.as_tuple() for view in gradients.views],
        beta1=beta1,
        beta2=beta2,
        epsilon=eps,
        step=step,
        threads=thread_count(threads),
    )


def _check(shape: torch.Size, **tensors: Tensor) -> None:
    """ValueError naming the first tensor that is not contiguous float32 of this shape: the kernel would write a copy,
    or past its end."""
    for name, tensor in tensors.items():
        if tensor.dtype != torch.float32 or not tensor.is_contiguous() or tensor.shape != shape:
            layout = "contiguous" if tensor.is_contiguous() else "strided"
            found = f"{layout} {dtype_name(tensor.dtype)} {list(tensor.shape)}"
            raise ValueError(f"{name} must be contiguous float32 {list(shape)}, got {found}")


def _check_rows(rows: Tensor | None, count: int, step: int) -> None:
    if rows is not None and (rows.dtype != torch.uint8 or list(rows.shape) != [count]):
        raise ValueError(f"sparse_rows must be uint8 [{count}], got {dtype_name(rows.dtype)} {list(rows.shape)}")
    if step < 1:
        raise ValueError(f"step must be at least 1, got {step}")
