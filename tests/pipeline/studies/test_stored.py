"""Figures of the kernel are stored only if all are of today's."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.studies.stored import STORED, store

KERNEL, OTHER = "0123456789ab", "ba9876543210"


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """New figures of KERNEL, and the folders that stored ones go to."""
    for folder, files in STORED.items():
        (tmp_path / folder).mkdir(parents=True)
        for name, place in files.items():
            (tmp_path / folder / name).write_text(f"a machine; kernel {KERNEL}; {name}")
            (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
    return tmp_path


def places(root: Path) -> list[Path]:
    return [root / place for files in STORED.values() for place in files.values()]


def test_new_figures_are_copied(root: Path):
    assert store(root, KERNEL) == 0
    assert all(KERNEL in place.read_text() for place in places(root))
    assert store(root, KERNEL, check=True) == 0


@pytest.mark.parametrize("text", [f"kernel {OTHER}", "no hash", None])
def test_figures_of_another_kernel_are_refused_and_nothing_is_copied(root: Path, capsys, text: str | None):
    file = root / "results/bench/bench.txt"
    file.unlink() if text is None else file.write_text(text)
    assert store(root, KERNEL) == 1
    assert not any(place.exists() for place in places(root))
    error = capsys.readouterr().err
    found = {f"kernel {OTHER}": OTHER, "no hash": "none stated", None: "no file"}[text]
    assert error == f"results/bench/bench.txt: expected figures of kernel {KERNEL}, found {found}\n"


def test_check_names_stored_figures_of_another_kernel(root: Path, capsys):
    store(root, KERNEL)
    assert store(root, OTHER, check=True) == 1
    assert capsys.readouterr().err.count(f"expected figures of kernel {OTHER}, found {KERNEL}") == len(STORED)
