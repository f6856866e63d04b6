"""Input validation: scalars of any type, finite parameters, and memory layout."""

from __future__ import annotations

import math
import numbers
from typing import Any

import torch

from rasterizer.gaussians import Gaussians

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
    """Raise ValueError naming the first tensor that is not contiguous, on the CPU and of `dtype`."""
    for name, tensor in gaussians.tensors().items():
        plain = tensor.device.type == "cpu" and tensor.layout == torch.strided and not tensor.is_neg()
        if tensor.dtype != dtype or not plain or not tensor.is_contiguous():
            kind, shape = dtype_name(tensor.dtype), list(tensor.shape)
            if not plain:
                kind += f", {'negated' if tensor.layout == torch.strided else tensor.layout} on {tensor.device},"
            elif not tensor.is_contiguous():
                kind += ", not contiguous,"
            raise ValueError(f"{name} must be contiguous {dtype_name(dtype)} {shape}, got {kind} {shape}")
