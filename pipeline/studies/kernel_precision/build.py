"""Builds kernels with other numerical choices, by the project's own CMake file, and loads them.

They go to build/variants/, outside the package; what is built already is not built again.
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

from pipeline.studies.kernel_precision.narrowed import SH_TYPES, Narrowed
from pipeline.studies.kernel_precision.variants import Choices, Variant
from rasterizer.kernel import kernel, load_kernel_at

SOURCE = Path(__file__).resolve().parents[3]
_LONGEST = 300  # characters of what a failed command said, from its first error on


class BuildError(RuntimeError):
    """One line: what could not be built, and why."""


def load_variants(variants: Sequence[Variant], folder: Path = SOURCE / "build") -> dict[str, ModuleType | Narrowed]:
    """The kernel of each variant by its name, for the instruction set of this process; built where it is missing.

    Raises BuildError when there is no CMake or no compiler, or when either fails.
    """
    own = [variant for variant in variants if variant.is_built]
    others = {variant.name: kernel for variant in variants if variant not in own}
    if own:
        _build(own, folder)
    suffix = sysconfig.get_config_var("EXT_SUFFIX")
    loaded = {variant.name: load_kernel_at(folder / "variants" / f"{_module(variant)}{suffix}") for variant in own}
    for variant in own:
        found = Choices(**loaded[variant.name].choices)
        if found != variant.choices:
            raise BuildError(f"variant {variant.name}: expected {variant.choices}, found a kernel with {found}")
    narrow = {v.name: Narrowed(loaded[v.name]) for v in own if v.choices.sh_type in SH_TYPES}
    return others | loaded | narrow


def _module(variant: Variant) -> str:
    return f"_variant_{variant.name}_{_isa()}"


def _isa() -> str:
    return kernel.__name__.rsplit("_", 1)[1]


def _build(variants: Sequence[Variant], folder: Path) -> None:
    tools = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    cmake = shutil.which("cmake", path=tools)
    if cmake is None:
        raise BuildError("work-precision: expected cmake on the path to build kernels with, found none: run make first")
    provenance = os.environ | {"PATH": tools}
    described = ";".join("|".join([_module(v), _isa(), *v.choices.definitions()]) for v in variants)
    configure = [cmake, "-S", str(SOURCE), "-B", str(folder), f"-DRASTERIZER_VARIANTS={described}"]
    if not (folder / "CMakeCache.txt").exists():  # not set up by `make`: say what scikit-build-core says there
        import nanobind

        configure += [
            "-DCMAKE_BUILD_TYPE=Release",
            f"-DPython_EXECUTABLE={sys.executable}",
            f"-Dnanobind_DIR={nanobind.cmake_dir()}",
        ]
        configure += ["-G", "Ninja"] if shutil.which("ninja", path=tools) else []
    _call(configure, provenance)
    _call([cmake, "--build", str(folder), "--target", *map(_module, variants)], provenance)


def _call(command: list[str], provenance: dict[str, str]) -> None:
    done = subprocess.run(command, env=provenance, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode:
        found = re.search(r"[^\n]*[Ee]rror[\s\S]*", done.stdout)
        said = " ".join((found.group() if found else done.stdout).split())
        raise BuildError(
            f"work-precision: expected {Path(command[0]).name} and a C++ compiler to build the variants, "
            f"found: {said[:_LONGEST] or 'no word from it'}"
        )
