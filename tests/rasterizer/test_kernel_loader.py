"""Which compiled kernel is loaded: the best that was built for this machine, and one line where there is none."""

from __future__ import annotations

from pathlib import Path

import pytest

from rasterizer import _cpu, kernel_loader

ROOT = Path(__file__).resolve().parents[2]


def test_the_kernels_that_make_compiles_are_there():
    """The best one after `make setup`, all after `make test`. Compiled code says what the processor supports."""
    supported = _cpu.supported_levels()
    expected = supported if (ROOT / "build/.all_kernels").exists() else supported[:1]
    assert kernel_loader.available_isas()[: len(expected)] == expected


def test_the_best_one_that_was_built_is_loaded(monkeypatch):
    """A checkout built on another machine of a cluster may lack the best one of this machine."""
    best = kernel_loader.available_isas()[0]
    monkeypatch.setattr(_cpu, "supported_levels", lambda: ["v9", best])
    assert kernel_loader.load_kernel().__name__ == f"rasterizer._kernel_{best}"


def test_a_kernel_that_is_not_there_is_one_clear_line(monkeypatch):
    with pytest.raises(ValueError, match="RASTERIZER_ISA: expected one of .*, found 'v9'"):
        kernel_loader.load_kernel("v9")
    monkeypatch.setattr(_cpu, "supported_levels", list)
    with pytest.raises(ImportError, match="make clean build"):
        kernel_loader.load_kernel()
