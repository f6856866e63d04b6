"""Which compiled kernel is loaded: the best that was built for this machine, and one line where there is none."""

from __future__ import annotations

from pathlib import Path

import pytest

from rasterizer import _cpu, kernel_loader

ROOT = Path(__file__).resolve().parents[2]


def test_the_kernel_of_the_best_instruction_set_is_built():
    """What the processor supports is said by compiled code, what was built by the files."""
    assert kernel_loader.available_isas()[0] == _cpu.supported_levels()[0]


@pytest.mark.skipif(not (ROOT / "build/.all_kernels").exists(), reason="`make test` compiles the other kernels")
def test_make_test_has_a_kernel_for_every_instruction_set_of_this_machine():
    assert kernel_loader.available_isas() == _cpu.supported_levels()


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
