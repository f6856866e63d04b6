"""Finds the real data sets in DATA_DIR; a missing one is an error of one line before any test."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

LEGO = "the D-NeRF release's lego scene as DATA_DIR/dnerf/lego or DATA_DIR/lego"
PHOTOGRAPHS = (
    "a folder of photographs as DATA_DIR/photographs, with the lens's K.txt in it or beside it (openMVG's "
    "ImageDataset_SceauxCastle has both)"
)


def data_dir() -> Path | None:
    return Path(os.environ["DATA_DIR"]) if os.environ.get("DATA_DIR") else None


def find_lego(root: Path) -> Path | None:
    return next((p for p in (root / "dnerf" / "lego", root / "lego") if (p / "transforms_train.json").is_file()), None)


def find_intrinsics(root: Path) -> Path | None:
    folder = root / "photographs"
    return next((path for path in (folder / "K.txt", root / "K.txt") if folder.is_dir() and path.is_file()), None)


def pytest_collection_finish(session: pytest.Session) -> None:
    """Only if these tests are selected: `make test` deselects them."""
    # Driving logs are optional: a test of them skips where DATA_DIR lacks its log.
    needed = [item for item in session.items if item.get_closest_marker("data") and "driving_logs" not in item.nodeid]
    if not needed:
        return
    root = data_dir()
    if root is None:
        raise pytest.UsageError(f"expected DATA_DIR=FOLDER, found none; put there {LEGO}, and {PHOTOGRAPHS}")
    missing = [what for find, what in ((find_lego, LEGO), (find_intrinsics, PHOTOGRAPHS)) if find(root) is None]
    if missing:
        raise pytest.UsageError(f"DATA_DIR={root}: expected {', and '.join(missing)}; found none")


@pytest.fixture(scope="session")
def lego() -> Path:
    return find_lego(data_dir())


@pytest.fixture(scope="session")
def photograph_folder() -> Path:
    return data_dir() / "photographs"


@pytest.fixture(scope="session")
def focal() -> float:
    """Of the photographs at full size, pixels: the first number of K.txt, a 3 × 3 matrix."""
    return float(find_intrinsics(data_dir()).read_text().split()[0])
