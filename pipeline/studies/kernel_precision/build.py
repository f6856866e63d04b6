"""Builds variants of the kernel with the project's CMakeLists.txt, and loads them.

They are written to build/variants/, outside the package, and built only where they are missing or out of date.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import torch
from torch import Tensor

from pipeline.studies.kernel_precision.variants import NumericalChoices, Variant
from rasterizer.kernel_loader import kernel, load_kernel_at

SOURCE = Path(__file__).resolve().parents[3]
SH_TYPES = {"Float16": torch.float16, "Bfloat16": torch.bfloat16}  # C++ type of the kernel's sh_type -> torch's
_MAX_MESSAGE = 300  # characters of a failed command's output that are shown, from its first error on


class BuildError(OSError):
    """A kernel could not be built. One line that names the cause."""


def load_variants(
    variants: Sequence[Variant], folder: Path = SOURCE / "build", flags: Sequence[str] = ()
) -> dict[str, ModuleType]:
    """The kernel of each variant by its name, for the instruction set of this process. flags: further ones for the
    compiler.

    BuildError where CMake or a compiler is missing or fails.
    """
    own = [variant for variant in variants if variant.is_built]
    others = {variant.name: kernel for variant in variants if variant not in own}
    if own:
        _build(own, folder, flags)
    suffix = sysconfig.get_config_var("EXT_SUFFIX")
    loaded = {variant.name: load_kernel_at(folder / "variants" / f"{_module(variant)}{suffix}") for variant in own}
    for variant in own:
        found = NumericalChoices(**loaded[variant.name].choices)
        if found != variant.choices:
            raise BuildError(f"variant {variant.name}: expected {variant.choices}, found a kernel with {found}")
    half = {v.name: HalfPrecisionSH(loaded[v.name]) for v in own if v.choices.sh_type in SH_TYPES}
    return others | loaded | cast("dict[str, ModuleType]", half)  # a HalfPrecisionSH stands in for its module


def _module(variant: Variant) -> str:
    return f"_variant_{variant.name}_{_isa()}"


def _isa() -> str:
    return kernel.__name__.rsplit("_", 1)[1]


def _build(variants: Sequence[Variant], folder: Path, flags: Sequence[str]) -> None:
    tools = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    cmake = shutil.which("cmake", path=tools)
    if cmake is None:
        raise BuildError("kernel_precision: expected cmake on the path to build kernels, found none: run make first")
    environment = os.environ | {"PATH": tools}
    described = ";".join("|".join([_module(v), _isa(), *v.choices.flags(), *flags]) for v in variants)
    configure = [cmake, "-S", str(SOURCE), "-B", str(folder), f"-DRASTERIZER_VARIANTS={described}"]
    if not (folder / "CMakeCache.txt").exists():  # not configured by `make` yet: the definitions of scikit-build-core
        import nanobind

        configure += [
            "-DCMAKE_BUILD_TYPE=Release",
            f"-DPython_EXECUTABLE={sys.executable}",
            f"-Dnanobind_DIR={nanobind.cmake_dir()}",
        ]
        configure += ["-G", "Ninja"] if shutil.which("ninja", path=tools) else []
    _call(configure, environment)
    _call([cmake, "--build", str(folder), "--target", *map(_module, variants)], environment)


def _call(command: list[str], environment: dict[str, str]) -> None:
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode:
        found = re.search(r"[^\n]*[Ee]rror[\s\S]*", done.stdout)
        message = " ".join((found.group() if found else done.stdout).split())
        raise BuildError(
            f"kernel_precision: expected {Path(command[0]).name} and a C++ compiler to build the variants, "
            f"found: {message[:_MAX_MESSAGE] or 'no output'}"
        )


class HalfPrecisionSH:
    """The kernel `module`, built for 16-bit SH; its models are made from float32 coefficients, rounded once a tensor.

    A model in half precision would be rounded when it is stored, so rounding is no part of a frame's time. Coefficients
    must not change between frames.
    """

    def __init__(self, module: ModuleType) -> None:
        self._module, self._type = module, SH_TYPES[module.choices["sh_type"]]
        self._given: Tensor | None = None
        self._rounded: Tensor | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._module, name)

    def Gaussians(self, sh: Tensor, **others: Any) -> Any:  # noqa: N802  # the module's class
        if self._given is None or self._given.data_ptr() != sh.data_ptr():
            self._given, self._rounded = sh, sh.to(self._type)
        return self._module.Gaussians(sh=self._rounded, **others)
