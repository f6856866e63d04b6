"""The parameters of N 4D Gaussians: plain tensors, checked for shape and type."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor

from rasterizer.trajectories import Trajectories

Motion = Literal["static", "separable", "velocity", "full"]

SH_DEGREES = {1: 0, 4: 1, 9: 2, 16: 3}  # degree l by number of spherical harmonics (l+1)²
MAX_FOURIER_ORDER = 2
OPTIONAL = ("quat_right", "velocity", "weights", "trajectories")  # fields that some of the models lack
# ((l+1)², n+1) by number of stored coefficients (n+1)(l+1)², n the Fourier order; all twelve products differ.
SH_LAYOUTS = {count * orders: (count, orders) for count in SH_DEGREES for orders in range(1, MAX_FOURIER_ORDER + 2)}


@dataclass(frozen=True)
class Gaussians:
    """N Gaussians before activation: the trained parameters (docs/method.md 1). Raises ValueError for wrong shapes.

    The shapes say which model it is:

    - full 4D: `mean` (N, 4), `log_scale` (N, 4), `quat_left` and `quat_right` (N, 4), R = L(ql) R(qr);
    - separable (no 4D rotation): `mean`, `log_scale` (N, 4), `quat_left` a 3D rotation (w, x, y, z), `quat_right` None;
    - velocity: as separable, and `velocity` (N, 3). The same 4D Gaussians as full in other parameters: the covariance
      of the slice at any time, the standard deviation in time, and what μ(t) moves in a unit of time;
    - separable or velocity with `weights` (N, K) of K shared `trajectories`, along which the Gaussians move besides;
    - static (ordinary 3D Gaussian Splatting): `mean`, `log_scale` (N, 3), `quat_left` a 3D rotation, `quat_right` None.
    """

    mean: Tensor  # (N, 4) xyzt, world units and units of time; (N, 3) when static
    log_scale: Tensor  # (N, 4) or (N, 3); scale = exp
    quat_left: Tensor  # (N, 4); need not be normalised, zero is read as identity
    quat_right: Tensor | None  # (N, 4) or None
    opacity_logit: Tensor  # (N,); opacity = sigmoid
    sh: Tensor  # (N, (n+1)(l+1)², 3), Fourier order major
    velocity: Tensor | None = None  # (N, 3) world units per unit of time, or None
    weights: Tensor | None = None  # (N, K) of the trajectories, or None
    trajectories: Trajectories | None = None  # K; given if weights are

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__.keys() - {"trajectories"}:
            value = getattr(self, name)
            if not isinstance(value, Tensor) and not (name in OPTIONAL and value is None):
                raise ValueError(f"{name} must be a tensor, got {type(value).__name__}")
        n = self.mean.shape[0] if self.mean.ndim == 2 else -1
        dims = self.mean.shape[1] if self.mean.ndim == 2 else -1
        if dims not in (3, 4):
            raise ValueError(f"mean must be [N, 4] or, static, [N, 3], got {list(self.mean.shape)}")
        expected = {"log_scale": [n, dims], "quat_left": [n, 4], "opacity_logit": [n]}
        if self.quat_right is not None:
            if dims == 3:
                raise ValueError("quat_right must be None when mean is [N, 3] (static), got a tensor")
            expected["quat_right"] = [n, 4]
        if self.velocity is not None:
            if dims == 3 or self.quat_right is not None:
                raise ValueError("velocity must be None when mean is [N, 3] (static) or quat_right given, got a tensor")
            expected["velocity"] = [n, 3]
        if (self.weights is None) != (self.trajectories is None):
            raise ValueError("weights and trajectories must both be given, or neither, got one")
        if self.weights is not None and self.trajectories is not None:
            if dims == 3 or self.quat_right is not None:
                raise ValueError("weights must be None when mean is [N, 3] (static) or quat_right given, got a tensor")
            expected["weights"] = [n, len(self.trajectories)]
        for name, shape in expected.items():
            found = list(getattr(self, name).shape)
            if found != shape:
                raise ValueError(f"{name} must be {shape}, got {found}")
        if self.sh.ndim != 3 or (self.sh.shape[0], self.sh.shape[2]) != (n, 3) or self.sh.shape[1] not in SH_LAYOUTS:
            raise ValueError(f"sh must be [{n}, (n+1)(l+1)², 3] with n <= 2, l <= 3, got {list(self.sh.shape)}")
        if dims == 3 and self.fourier_order > 0:
            raise ValueError(f"a static model has Fourier order 0 only, got sh {list(self.sh.shape)}")
        for name, tensor in self.tensors().items():
            if tensor.dtype != self.mean.dtype:
                raise ValueError(f"{name} must be {self.mean.dtype} as mean is, got {tensor.dtype}")

    @classmethod
    def from_tensors(cls, tensors: dict[str, Tensor], span: tuple[float, float] = (0.0, 1.0)) -> Gaussians:
        """From tensors by field name; those of OPTIONAL may be missing. `trajectories`: control points over `span`."""
        fields: dict[str, Any] = {"quat_right": None, **tensors}
        if "trajectories" in fields:
            fields["trajectories"] = Trajectories(fields["trajectories"], span)
        return cls(**fields)

    @property
    def sh_degree(self) -> int:
        """Degree l of the spherical harmonics."""
        return SH_DEGREES[SH_LAYOUTS[self.sh.shape[1]][0]]

    @property
    def fourier_order(self) -> int:
        """Order n of the Fourier series in time; 0 for constant colours."""
        return SH_LAYOUTS[self.sh.shape[1]][1] - 1

    @property
    def motion(self) -> Motion:
        """Which of the four models it is."""
        if self.mean.shape[1] == 3:
            return "static"
        if self.velocity is not None:
            return "velocity"
        return "separable" if self.quat_right is None else "full"

    def __len__(self) -> int:
        return self.mean.shape[0]

    def tensors(self) -> dict[str, Tensor]:
        """The parameters by field name, without those that are None; of the trajectories the control points."""
        named = self.row_tensors()
        return named if self.trajectories is None else named | {"trajectories": self.trajectories.control_points}

    def row_tensors(self) -> dict[str, Tensor]:
        """Those that have a row for each Gaussian: all but the trajectories."""
        named = {name: getattr(self, name) for name in self.__dataclass_fields__ if name != "trajectories"}
        return {name: tensor for name, tensor in named.items() if tensor is not None}

    @property
    def span(self) -> tuple[float, float]:
        """Of the trajectories."""
        return (0.0, 1.0) if self.trajectories is None else self.trajectories.span

    def to(self, dtype: torch.dtype) -> Gaussians:
        """The same Gaussians in another floating-point type."""
        return Gaussians.from_tensors({name: tensor.to(dtype) for name, tensor in self.tensors().items()}, self.span)

    def rows(self, index: Tensor | slice) -> Gaussians:
        """The Gaussians of these rows: `index` (M,) integers, or (N,) bool; a slice copies nothing."""
        rows: dict[str, Any] = {name: tensor[index] for name, tensor in self.row_tensors().items()}
        return Gaussians(**{"quat_right": None, **rows}, trajectories=self.trajectories)
