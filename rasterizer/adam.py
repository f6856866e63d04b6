"""Fused Adam in C++: one pass over parameter, gradient and both moments, with torch.optim.Adam's arithmetic."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from rasterizer import on_device
from rasterizer.cores import thread_count
from rasterizer.gaussians import SH_LAYOUTS
from rasterizer.gradients import Gradients
from rasterizer.kernel_loader import kernel
from rasterizer.validation import check_array, is_integer_in, short_repr

MAX_STEP = 2**31 - 1  # the kernel's int
_ADAM = {"beta1": 0.9, "beta2": 0.999, "epsilon": 1e-15}  # of 3DGS


def adam_step(
    param: Tensor,
    grad: Tensor,
    m: Tensor,
    v: Tensor,
    lr: float | Sequence[float],
    step: int,
    sparse_rows: Tensor | None = None,
    threads: int = 0,
) -> None:
    """Update `param` (N,) or (N, C) and its moments m, v in place; all contiguous float32.

    lr: one learning rate, or one per column. step: counts from 1. sparse_rows (N,) uint8: rows with 0 are skipped,
    moments included (dense Adam would still move them by their momentum). ValueError for tensors that are not
    contiguous float32 of one shape, a wrong number of rates or rows, and a step below 1.
    """
    if on_device.is_on_device(param):
        rate = lr if isinstance(lr, float) else param.new_tensor(lr)
        on_device.adam_step(param, grad, m, v, rate, step, sparse_rows, **_ADAM)
        return
    for name, tensor in (("param", param), ("grad", grad), ("m", m), ("v", v)):
        check_array(name, tensor, torch.float32, param.shape)
    if param.ndim not in (1, 2):
        raise ValueError(f"param must be (N,) or (N, C), got {list(param.shape)}")
    _check_step(sparse_rows, len(param), step)
    columns = param.shape[1] if param.ndim == 2 else 1
    given = np.asarray(lr, np.float64)
    rates = given.tolist() if given.ndim else [float(given)] * columns
    if len(rates) != columns:
        raise ValueError(f"lr must hold one rate or one for each of {columns} columns, got {len(rates)}")
    kernel.adam_step(
        param=param,
        grad=grad,
        m=m,
        v=v,
        lr=rates,
        sparse_rows=sparse_rows,
        step=step,
        threads=thread_count(threads),
        **_ADAM,
    )


def sh_adam_step(
    sh: Tensor,
    gradients: Gradients,
    m: Tensor,
    v: Tensor,
    lr: Sequence[float],
    step: int,
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
    if on_device.is_on_device(sh):
        coefficients, orders = SH_LAYOUTS[sh.shape[1]]
        constant, by_direction, by_time, by_both = lr
        rates = [[constant] + [by_direction] * (coefficients - 1)]
        rates += [[by_time] + [by_both] * (coefficients - 1)] * (orders - 1)
        rate = sh.new_tensor(rates).view(-1, 1)
        on_device.adam_step(sh, gradients.sh(), m, v, rate, step, sparse_rows, **_ADAM)
        return
    for name, tensor in (("sh", sh), ("m", m), ("v", v)):
        check_array(name, tensor, torch.float32, gradients.sh_shape)
    _check_step(sparse_rows, len(sh), step)
    if len(lr) != 4:
        raise ValueError(f"lr must hold four rates, got {len(lr)}")
    coefficients, orders = SH_LAYOUTS[sh.shape[1]]
    used_orders = 1 + max((view.fourier_order for view in gradients.views), default=0)
    used_coefficients = (1 + max((view.sh_degree for view in gradients.views), default=0)) ** 2
    kernel.sh_adam_step(
        sh=sh,
        m=m,
        v=v,
        coefficients=coefficients,
        orders=orders,
        active_coefficients=min(used_coefficients, coefficients),
        active_orders=min(used_orders, orders),
        lr=[float(rate) for rate in lr],
        sparse_rows=sparse_rows,
        views=[view.as_tuple() for view in gradients.views],
        step=step,
        threads=thread_count(threads),
        **_ADAM,
    )


def _check_step(rows: Tensor | None, count: int, step: int) -> None:
    if rows is not None:
        check_array("sparse_rows", rows, torch.uint8, [count])
    if not is_integer_in(step, 1, MAX_STEP):
        raise ValueError(f"step must be an integer of at least 1, got {short_repr(step)}")
