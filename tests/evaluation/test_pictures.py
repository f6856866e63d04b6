"""PNG images of an evaluation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from pipeline.evaluation.pictures.view_pictures import DIFFERENCE_GAIN, png_saver


def test_render_truth_and_difference_are_written(tmp_path: Path) -> None:
    image, truth = np.full((4, 6, 3), 0.5, np.float32), np.full((4, 6, 3), 0.4, np.float32)
    png_saver(tmp_path / "renders")("test/r_0", image, truth)
    read = {path.name: np.asarray(Image.open(path)) for path in (tmp_path / "renders").iterdir()}
    assert sorted(read) == ["test_r_0_difference.png", "test_r_0_render.png", "test_r_0_truth.png"]
    assert read["test_r_0_render.png"].shape == (4, 6, 3) and (read["test_r_0_render.png"] == 128).all()
    assert (read["test_r_0_truth.png"] == 102).all()
    assert (read["test_r_0_difference.png"] == round(0.1 * DIFFERENCE_GAIN * 255)).all()
