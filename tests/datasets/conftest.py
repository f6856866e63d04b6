"""Fixtures that tests of several readers share."""

from __future__ import annotations

from pathlib import Path

import pytest
from plenoptic_folder import write_folder


@pytest.fixture(scope="session")
def video_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three synchronised videos with poses_bounds.npy; to be copied before it is changed."""
    return write_folder(tmp_path_factory.mktemp("videos"))
