"""Structure from motion on real photographs with a calibrated lens."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from datasets.source import Photograph
from pipeline.config.schema import InitConfig
from pipeline.data.sfm.__main__ import SUFFIXES, main, read_photographs
from pipeline.data.sfm.reconstruction import Reconstruction
from pipeline.data.sfm.run import reconstruct

pytestmark = pytest.mark.data

WIDTH = 472  # pixels, approximate: one second per photograph
CFG = InitConfig(max_features=1500)


@pytest.fixture(scope="module")
def downscale(photograph_folder: Path) -> int:
    first = next(path for path in sorted(photograph_folder.iterdir()) if path.suffix.lower() in SUFFIXES)
    with Image.open(first) as image:
        return max(1, round(image.width / WIDTH))


@pytest.fixture(scope="module")
def photographs(photograph_folder: Path, downscale: int) -> list[Photograph]:
    """All photographs of the folder; the third is held out."""
    return [replace(p, held_out=i == 2) for i, p in enumerate(read_photographs(photograph_folder, downscale))]


@pytest.fixture(scope="module")
def found(photographs: list[Photograph], photograph_folder: Path) -> Reconstruction:
    return reconstruct(photographs, CFG, 1.0, photograph_folder)


def test_all_photographs_are_registered_at_the_calibrated_focal_length(
    found, photographs, focal: float, downscale: int
) -> None:
    assert set(found.cameras) == {p.name for p in photographs} and found.photographs == len(photographs) - 1
    assert found.errors.mean() < 0.8 and len(found.points) > 500
    for calibrated in found.cameras.values():  # the calibration used other photographs
        assert calibrated.camera.fx == pytest.approx(focal / downscale, rel=0.03)


def test_held_out_pose_is_between_its_neighbours(found: Reconstruction, photographs: list[Photograph]) -> None:
    """The photographs are a sequence: the third position is between the second and the fourth."""
    second, third, fourth = (found.cameras[photographs[i].name].camera.position for i in (1, 2, 3))
    along = fourth - second
    assert 0.2 < (third - second) @ along / (along @ along) < 0.8
    assert np.linalg.norm(np.cross(third - second, along)) / (along @ along) < 0.4


def test_command_line(photograph_folder: Path, photographs, downscale: int, capsys) -> None:
    assert main([str(photograph_folder), "--downscale", str(downscale), "--max-features", "1000"]) == 0
    assert f"{len(photographs)} of {len(photographs)} photographs" in capsys.readouterr().out
