"""Loads the compiled kernel: the best instruction set of this processor, or the one that RASTERIZER_ISA names.

RASTERIZER_KERNELS names a folder of other builds, which is searched first (tools/sanitize.py).
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import os
from functools import cache
from pathlib import Path
from types import ModuleType

_PACKAGE = importlib.import_module(__package__)
_cpu = importlib.import_module(f"{__package__}._cpu")

ISA_VARIABLE = "RASTERIZER_ISA"
FOLDER_VARIABLE = "RASTERIZER_KERNELS"


def available_isas() -> list[str]:
    """Instruction sets that this processor supports and a kernel was built for, best first: v4, v3, v2 (x86-64
    levels), or plain. A checkout has those of the machine that built it, a wheel has all."""
    return [isa for isa in _cpu.supported_levels() if importlib.util.find_spec(f"{__package__}._kernel_{isa}")]


def load_kernel(isa: str | None = None) -> ModuleType:
    """The kernel compiled for `isa`; None: the best one. Raises ValueError when there is no such kernel or the
    processor cannot run it, ImportError when there is none at all."""
    isas = available_isas()
    if not isas:
        raise ImportError("no compiled kernel that this processor can run: `make clean build` compiles one")
    if isa is None:
        isa = isas[0]
    if isa not in isas:
        raise ValueError(
            f"{ISA_VARIABLE}: expected one of {', '.join(isas)} (built, and what this processor has), found {isa!r}"
        )
    return importlib.import_module(f"rasterizer._kernel_{isa}")


@cache
def source_hash() -> str:
    """Of the C++ source that kernels are compiled from and its compiler flags, 12 digits: figures of one kernel are not
    those of another. "unknown" where the source is not installed."""
    folder = Path(__file__).resolve().parent
    files = [folder.parent / "CMakeLists.txt", *sorted((folder / "src").rglob("*.?pp"))]
    if not all(file.is_file() for file in files) or len(files) == 1:
        return "unknown"
    digest = hashlib.blake2b(digest_size=6)
    for file in files:
        digest.update(file.relative_to(folder.parent).as_posix().encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()


def load_kernel_at(path: Path) -> ModuleType:
    """A kernel built outside the package, <module name>.<suffix>: the same source with other numerical choices."""
    specification = importlib.util.spec_from_file_location(path.name.split(".")[0], path)
    if specification is None or specification.loader is None:
        raise ImportError(f"expected a compiled module, found {path}")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


if FOLDER_VARIABLE in os.environ:
    _PACKAGE.__path__.insert(0, os.environ[FOLDER_VARIABLE])
kernel = load_kernel(os.environ.get(ISA_VARIABLE) or None)  # what the package renders with
