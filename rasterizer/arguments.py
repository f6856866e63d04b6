"""What is asked of a rasterizer besides the Gaussians, checked: errors say what was expected and found."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from rasterizer.camera import Camera
from rasterizer.gaussians import Gaussians
from rasterizer.number import as_float, is_whole, shown
from rasterizer.output import OUTPUT_NAMES

SHORTEST_DURATION = 1e-30  # colours change by up to 2π/T a unit of time, which float32 must hold
LONGEST_FLOW = 1e30  # likewise the way moved in δ, at any speed that float32's scales give
LARGEST_FLOAT32 = torch.finfo(torch.float32).max


@dataclass(frozen=True)
class Request:
    """One view to render. Raises ValueError for a value that is not finite, out of range or missing."""

    camera: Camera
    time: float = 0.0  # in the unit of μt, as are duration and flow_dt
    duration: float = 1.0  # T of 4DSH's cosines
    background: Sequence[float] = (0.0, 0.0, 0.0)  # RGB
    outputs: Sequence[str] = ("color",)
    flow_dt: float | None = None  # δ of the optical flow
    near: float = 0.2  # world units along the viewing axis
    sh_degree: int | None = None  # use only the coefficients up to it; None: all that are stored
    fourier_order: int | None = None  # likewise

    def __post_init__(self) -> None:
        time, duration, near = (as_float(value) for value in (self.time, self.duration, self.near))
        if not math.isfinite(time):
            raise ValueError(f"time must be finite, got {shown(self.time)}")
        if not (math.isfinite(duration) and duration > 0):
            raise ValueError(f"duration must be finite and > 0, got {shown(self.duration)}")
        if duration < SHORTEST_DURATION:
            raise ValueError(f"duration must be at least {SHORTEST_DURATION:g}, got {shown(self.duration)}")
        if not (math.isfinite(near) and near >= 0):
            raise ValueError(f"near must be finite and >= 0, got {shown(self.near)}")
        background = tuple(as_float(value) for value in _listed(self.background))
        if len(background) != 3 or not all(abs(value) <= LARGEST_FLOAT32 for value in background):
            raise ValueError(f"background must be 3 finite numbers, got {shown(self.background)}")
        outputs = _listed(self.outputs)
        for name in outputs:
            if not (isinstance(name, str) and name in OUTPUT_NAMES):
                raise ValueError(f"outputs must be among {', '.join(OUTPUT_NAMES)}, got {shown(name)}")
        if not outputs:
            raise ValueError(f"outputs must be some of {', '.join(OUTPUT_NAMES)}, got none")
        if "flow" in outputs and not abs(as_float(self.flow_dt)) <= LONGEST_FLOW:
            raise ValueError(f"flow_dt must be finite when outputs has 'flow', got {shown(self.flow_dt)}")
        # Numbers of any kind may be given; from here on they are floats. An output named twice is one.
        for name, value in (
            ("time", time),
            ("duration", duration),
            ("near", near),
            ("background", background),
            ("outputs", tuple(dict.fromkeys(outputs))),
        ):
            object.__setattr__(self, name, value)

    def check_against(self, gaussians: Gaussians) -> None:
        """Raise ValueError where the Gaussians do not have what is asked of them."""
        if "stats" in self.outputs and gaussians.motion == "static":
            raise ValueError("outputs must not have 'stats' for a static model, which has no time")
        for name in ("sh_degree", "fourier_order"):
            limit, stored = getattr(self, name), getattr(gaussians, name)
            if limit is not None and not is_whole(limit, 0, stored):
                raise ValueError(f"{name} must be in 0..{stored}, as stored, got {shown(limit)}")


def _listed(value: object) -> list:
    """Its items; the thing itself where it has none, text too."""
    try:
        return [value] if isinstance(value, str) else list(value)
    except TypeError:
        return [value]


def check_finite(gaussians: Gaussians) -> None:
    """Raise ValueError that names the first parameter, and its index, that is NaN or infinite, or no float at all."""
    for name, tensor in gaussians.tensors().items():
        if not tensor.is_floating_point():
            raise ValueError(f"{name} must be floating point, got {str(tensor.dtype).removeprefix('torch.')}")
        # One fast pass: a sum is finite only if every entry is. It can overflow without one, hence the second look.
        if math.isfinite(tensor.detach().sum().item()):
            continue
        wrong = torch.nonzero(~torch.isfinite(tensor.detach()))
        if len(wrong):
            index = wrong[0].tolist()
            raise ValueError(f"{name}{index} must be finite, got {tensor[tuple(index)].item()}")
