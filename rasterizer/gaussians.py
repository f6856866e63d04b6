"""The set of Gaussians a rasterizer takes: plain tensors, and which kind of model they form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

Motion = Literal["static", "separable", "full"]

# (l+1)² spherical harmonics of degree l = 0..3, times Fourier orders n = 0..2.
SH_DEGREES = {1: 0, 4: 1, 9: 2, 16: 3}
MAX_FOURIER_ORDER = 2


@dataclass(frozen=True)
class Gaussians:
    """N Gaussians, before activation (docs/method.md 1): what is stored is what is trained.

    Which model it is follows from the shapes, so that nothing is stored that a scene does not need:

    - full 4D: `mean` (N, 4), `log_scale` (N, 4), `quat_left` and `quat_right` (N, 4), R = L(ql) R(qr);
    - separable (no 4D rotation): `mean`, `log_scale` (N, 4), `quat_left` a 3D rotation (w, x, y, z), `quat_right` None;
    - static (ordinary 3D Gaussian Splatting): `mean`, `log_scale` (N, 3), `quat_left` a 3D rotation, `quat_right` None.
    """

    mean: Tensor  # (N, 4) xyzt, world units and seconds; (N, 3) when static
    log_scale: Tensor  # (N, 4) or (N, 3); scale = exp
    quat_left: Tensor  # (N, 4); need not be normalised, zero is read as identity
    quat_right: Tensor | None  # (N, 4) or None
    opacity_logit: Tensor  # (N,); opacity = sigmoid
    sh: Tensor  # (N, (n+1)(l+1)², 3), Fourier order major

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if not isinstance(value, Tensor) and not (name == "quat_right" and value is None):
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
        for name, shape in expected.items():
            found = list(getattr(self, name).shape)
            if found != shape:
                raise ValueError(f"{name} must be {shape}, got {found}")
        if self.sh.ndim != 3 or self.sh.shape[0] != n or self.sh.shape[2] != 3 or self._sh_layout() is None:
            raise ValueError(f"sh must be [{n}, (n+1)(l+1)², 3] with n <= 2, l <= 3, got {list(self.sh.shape)}")
        if dims == 3 and self.fourier_order > 0:
            raise ValueError(f"a static model has Fourier order 0 only, got sh {list(self.sh.shape)}")
        for name, tensor in self.tensors().items():
            if tensor.dtype != self.mean.dtype:
                raise ValueError(f"{name} must be {self.mean.dtype} as mean is, got {tensor.dtype}")

    def _sh_layout(self) -> tuple[int, int] | None:
        """(degree l, Fourier order n) of the coefficient count; where several fit, the one with the highest degree."""
        count = self.sh.shape[1]
        for per_order in (16, 9, 4, 1):
            if count % per_order == 0 and 1 <= count // per_order <= MAX_FOURIER_ORDER + 1:
                return SH_DEGREES[per_order], count // per_order - 1
        return None

    @property
    def sh_degree(self) -> int:
        return self._sh_layout()[0]

    @property
    def fourier_order(self) -> int:
        return self._sh_layout()[1]

    @property
    def motion(self) -> Motion:
        if self.mean.shape[1] == 3:
            return "static"
        return "separable" if self.quat_right is None else "full"

    def __len__(self) -> int:
        return self.mean.shape[0]

    def tensors(self) -> dict[str, Tensor]:
        """The stored tensors by name; absent ones left out."""
        named = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return {name: tensor for name, tensor in named.items() if tensor is not None}

    def to(self, dtype: torch.dtype) -> Gaussians:
        """The same Gaussians in another floating-point type."""
        return Gaussians(
            **{
                name: None if getattr(self, name) is None else getattr(self, name).to(dtype)
                for name in self.__dataclass_fields__
            }
        )
