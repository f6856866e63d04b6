"""`Request`: the arguments of one rendered view besides the Gaussians, validated. `RenderOutput`: its images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from rasterizer.camera import Camera
from rasterizer.gaussians import Gaussians
from rasterizer.validation import as_float, is_integer_in, short_repr

OUTPUT_CHANNELS = {"color": 3, "alpha": 1, "depth": 1, "flow": 2, "stats": 2}
OUTPUT_NAMES = tuple(OUTPUT_CHANNELS)
MIN_DURATION = 1e-30  # colours change by up to 2π/T per unit of time, which float32 must represent
MAX_FLOW_DT = 1e30  # float32 must represent the displacement over δ, at any velocity that its scales allow
MAX_FLOAT32 = torch.finfo(torch.float32).max
# What the authors' programs did to the gradients of colour; images are the same (docs/baseline.md)
RELEASED_GRADIENTS = {
    "detached": "colour gives none to positions and times",
    "untrained": "coefficients that vary with time have none",
    "wrong_line": "the coefficient of Y_1,-1 has that of a constant, Y_00",
}


@dataclass(frozen=True)
class Request:
    """One view to render. Raises ValueError for a value that is not finite, out of range or missing."""

    camera: Camera
    time: float = 0.0  # in the unit of μt, as are duration and flow_dt
    duration: float = 1.0  # T of the Fourier series in time
    background: Sequence[float] = (0.0, 0.0, 0.0)  # RGB
    outputs: Sequence[str] = ("color",)  # names from OUTPUT_NAMES
    flow_dt: float | None = None  # δ of the optical flow; required for the output "flow"
    near: float = 0.2  # near plane: world units along the optical axis
    sh_degree: int | None = None  # use the coefficients up to this degree; None: all stored ones
    fourier_order: int | None = None  # likewise
    # p is evaluated at time + this; means, covariances and colours at time. Training alone uses it (docs/method.md 5.2)
    marginal_offset: float = 0.0
    flow_camera: Camera | None = None  # the camera at time + flow_dt, for the flow; None: it stands still
    released_gradients: Sequence[str] = ()  # names from RELEASED_GRADIENTS; none: the gradients are exact

    def __post_init__(self) -> None:
        for name in ("camera", "flow_camera"):
            value = getattr(self, name)
            if not (isinstance(value, Camera) or (name == "flow_camera" and value is None)):
                raise ValueError(f"{name} must be a Camera, got {short_repr(value)}")
        time, duration, near = (as_float(value) for value in (self.time, self.duration, self.near))
        offset = as_float(self.marginal_offset)
        if not math.isfinite(time):
            raise ValueError(f"time must be finite, got {short_repr(self.time)}")
        if not abs(offset) <= MAX_FLOAT32:
            raise ValueError(
                f"marginal_offset must be a number that float32 holds, got {short_repr(self.marginal_offset)}"
            )
        if not (math.isfinite(duration) and duration > 0):
            raise ValueError(f"duration must be finite and > 0, got {short_repr(self.duration)}")
        if duration < MIN_DURATION:
            raise ValueError(f"duration must be at least {MIN_DURATION:g}, got {short_repr(self.duration)}")
        if not (math.isfinite(near) and near >= 0):
            raise ValueError(f"near must be finite and >= 0, got {short_repr(self.near)}")
        background = tuple(as_float(value) for value in _as_list(self.background))
        if len(background) != 3 or not all(abs(value) <= MAX_FLOAT32 for value in background):
            raise ValueError(f"background must be 3 numbers that float32 holds, got {short_repr(self.background)}")
        outputs = self._checked_outputs()
        released = tuple(_as_list(self.released_gradients))
        for name in released:
            if not (isinstance(name, str) and name in RELEASED_GRADIENTS):
                raise ValueError(
                    f"released_gradients must be among {', '.join(RELEASED_GRADIENTS)}, got {short_repr(name)}"
                )
        # Scalars of any type are accepted and stored as floats; duplicate outputs are dropped.
        for name, value in (
            ("time", time),
            ("marginal_offset", offset),
            ("duration", duration),
            ("near", near),
            ("background", background),
            ("outputs", outputs),
            ("released_gradients", released),
        ):
            object.__setattr__(self, name, value)

    def _checked_outputs(self) -> tuple[str, ...]:
        outputs = _as_list(self.outputs)
        for name in outputs:
            if not (isinstance(name, str) and name in OUTPUT_NAMES):
                raise ValueError(f"outputs must be among {', '.join(OUTPUT_NAMES)}, got {short_repr(name)}")
        if not outputs:
            raise ValueError(f"outputs must be some of {', '.join(OUTPUT_NAMES)}, got none")
        if "flow" in outputs and not abs(as_float(self.flow_dt)) <= MAX_FLOW_DT:
            raise ValueError(
                f"flow_dt must be a number up to {MAX_FLOW_DT:g} for the output 'flow', got {short_repr(self.flow_dt)}"
            )
        return tuple(dict.fromkeys(outputs))

    def check_against(self, gaussians: Gaussians) -> None:
        """Raise ValueError for outputs or SH limits that these Gaussians do not have."""
        if "stats" in self.outputs and gaussians.motion == "static":
            raise ValueError("outputs must not have 'stats' for a static model, which has no time")
        for name in ("sh_degree", "fourier_order"):
            limit, stored = getattr(self, name), getattr(gaussians, name)
            if limit is not None and not is_integer_in(limit, 0, stored):
                raise ValueError(f"{name} must be in 0..{stored}, as stored, got {short_repr(limit)}")


@dataclass(frozen=True)
class RenderOutput:
    """Images of one view; outputs that were not requested are None.

    Sums go over the Gaussians at a pixel, with w the blending weight and T the transmittance behind the last one:
    """

    color: Tensor | None  # (3, H, W) Σ w c + T background
    alpha: Tensor | None = None  # (1, H, W) 1 - T
    depth: Tensor | None = None  # (1, H, W) Σ w z, world units along the optical axis
    flow: Tensor | None = None  # (2, H, W) Σ w (proj(μ(t+δ)) - proj(μ(t))), pixels right and down
    stats: Tensor | None = None  # (2, H, W) Σ w μt and Σ w Σtt


def _as_list(value: Any) -> list:
    """The items of a sequence; text and anything that is no sequence as the only item."""
    try:
        return [value] if isinstance(value, str) else list(value)
    except TypeError:
        return [value]
