"""Half-precision SH: kernels built for 16-bit coefficients, called with float32 coefficients."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import torch
from torch import Tensor

SH_TYPES = {"Float16": torch.float16, "Bfloat16": torch.bfloat16}  # C++ type of the kernel's sh_type -> torch's


class HalfPrecisionSH:
    """The kernel `module`, whose models are made from float32 coefficients, rounded once for each tensor.

    A model in half precision would be rounded when it is stored, so rounding is no part of a frame's time. Coefficients
    must not change between frames.
    """

    def __init__(self, module: ModuleType) -> None:
        self._module, self._type = module, SH_TYPES[module.choices["sh_type"]]
        self._given: Tensor | None = None
        self._rounded: Tensor | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._module, name)

    def Model(self, sh: Tensor, **others: Any) -> Any:  # noqa: N802  # the module's class
        if self._given is None or self._given.data_ptr() != sh.data_ptr():
            self._given, self._rounded = sh, sh.to(self._type)
        return self._module.Model(sh=self._rounded, **others)
