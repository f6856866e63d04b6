"""Input validation: scalars of any type, finite parameters, and memory layout."""

from __future__ import annotations

import math
import numbers
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from rasterizer.gaussians import Gaussians

MAX_GAUSSIANS = 2**31 - 1024  # the kernel numbers them with 32 bits, in chunks
MAX_REPR = 200  # characters


def as_float(value: Any) -> float:
    """`value` as a float; NaN for anything that is no number, text included, so that a finite check rejects it."""
    if isinstance(value, (str, bytes, bytearray)):
        return math.nan
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError, RuntimeError):  # RuntimeError: a tensor of several elements
        return math.nan


def is_integer_in(value: object, low: int, high: int) -> bool:
    """Whether `value` is an integer (Python's or numpy's) in low..high."""
    return isinstance(value, numbers.Integral) and low <= int(value) <= high


def short_repr(value: object) -> str:
    """repr(value) in one line of at most MAX_REPR characters, for error messages."""
    try:
        line = " ".join(repr(value).split())
    except ValueError:  # an integer with more digits than Python converts
        return f"a {type(value).__name__} too long to show"
    return line if len(line) <= MAX_REPR else f"{line[:MAX_REPR]} …"


def dtype_name(dtype: torch.dtype) -> str:
    """ "float32" for torch.float32."""
    return str(dtype).removeprefix("torch.")


def check_finite(gaussians: Gaussians) -> None:
    """Raise ValueError naming the first parameter, and its index, that is NaN, infinite or not floating point."""
    for name, tensor in gaussians.tensors().items():
        if not tensor.is_floating_point():
            raise ValueError(f"{name} must be floating point, got {dtype_name(tensor.dtype)}")
        # One fast pass: a sum is finite only if every element is. Finite elements may overflow it, hence the second.
        if math.isfinite(tensor.detach().sum().item()):
            continue
        wrong = torch.nonzero(~torch.isfinite(tensor.detach()))
        if len(wrong):
            index = wrong[0].tolist()
            raise ValueError(f"{name}{index} must be finite, got {tensor[tuple(index)].item()}")


def check_layout(gaussians: Gaussians, dtype: torch.dtype = torch.float32) -> None:
    """Raise ValueError for more Gaussians than MAX_GAUSSIANS, or naming the first tensor that the kernel can't read."""
    if len(gaussians) > MAX_GAUSSIANS:
        raise ValueError(f"expected at most {MAX_GAUSSIANS} Gaussians, got {len(gaussians)}")
    for name, tensor in gaussians.tensors().items():
        check_array(name, tensor, dtype, tensor.shape)


def check_array(name: str, tensor: Tensor, dtype: torch.dtype, shape: Sequence[int], contiguous: bool = True) -> None:
    """Raise ValueError unless `tensor` is on the CPU, of `dtype` and of `shape`: the kernel uses its memory.

    contiguous: it must be, too, and not a negated view. Otherwise `plain` makes it so.
    """
    on_cpu = tensor.device.type == "cpu" and tensor.layout == torch.strided
    whole = on_cpu and tensor.is_contiguous() and not tensor.is_neg()
    if tensor.dtype == dtype and list(tensor.shape) == list(shape) and (whole if contiguous else on_cpu):
        return
    kind = dtype_name(tensor.dtype)
    if not on_cpu:
        kind += f", {tensor.layout} on {tensor.device},"
    elif contiguous and not whole:
        kind += f", {'negated' if tensor.is_neg() else 'not contiguous'},"
    expected = f"{'contiguous ' if contiguous else ''}{dtype_name(dtype)} {list(shape)}"
    raise ValueError(f"{name} must be {expected}, got {kind} {list(tensor.shape)}")


def plain(tensor: Tensor) -> Tensor:
    """`tensor` detached and contiguous, a negated view resolved; a copy only where it must be."""
    return tensor.detach().resolve_neg().contiguous()
