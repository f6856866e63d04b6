"""Pictures of depth, flow and errors: colours of known values, and which files an evaluation writes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import rgb_to_hsv
from moving_gaussian import VELOCITY, moving_gaussian, scene_with_truth
from PIL import Image
from tiny import evaluation_config

from pipeline.evaluation.evaluate import evaluate_with_images
from pipeline.evaluation.pictures.false_colour import (
    depth_picture,
    depth_range,
    error_picture,
    flow_picture,
    value_picture,
)
from pipeline.evaluation.pictures.view_pictures import GAP, depth_parts


@pytest.mark.parametrize("angle", [0.0, 60.0, 135.0, 300.0])
def test_the_hue_of_flow_is_its_direction_and_the_saturation_its_length(angle: float) -> None:
    radians = np.radians(angle)
    flow = 1.5 * np.array([np.cos(radians), np.sin(radians)])[:, None, None]
    hue, saturation, value = rgb_to_hsv(flow_picture(flow, longest=3.0)[0, 0])
    assert 360 * hue == pytest.approx(angle, abs=0.01) and saturation == pytest.approx(0.5, abs=1e-5) and value == 1.0


def test_what_rests_is_white_and_what_is_unknown_black() -> None:
    flow = np.zeros((2, 1, 2))
    assert np.array_equal(flow_picture(flow, 1.0, np.array([[True, False]]))[0], [[1, 1, 1], [0, 0, 0]])
    for picture in (error_picture, lambda *a: value_picture(a[0], 0.0, *a[1:])):
        assert not picture(np.ones((1, 1)), 1.0, np.array([[False]])).any()


def test_nearer_is_brighter() -> None:
    depth = np.array([[0.0, 1.0, 2.0, 4.0, 9.0]])
    brightness = depth_picture(depth, near=1.0, far=4.0).sum(axis=-1)[0]
    assert brightness[0] == 0 and brightness[1] > brightness[2] > brightness[3] == brightness[4]
    assert depth_range(np.array([0.0, 3.0, 3.0])) == pytest.approx((3.0, 3.0), rel=1e-5)
    assert depth_range(np.zeros(3)) == (1.0, 2.0)


def test_depth_error_is_relative_and_only_where_the_truth_is_known() -> None:
    truth = np.array([[0.0, 2.0, 2.0]])
    error = depth_parts(np.array([[1.0, 2.0, 3.0]]), truth)[2]
    assert not error[0, 0].any() and error[0, 2].sum() > error[0, 1].sum()


def test_an_evaluation_writes_pictures_where_the_truth_is_known(tmp_path: Path) -> None:
    cfg = evaluation_config(videos=False)
    evaluate_with_images(moving_gaussian(VELOCITY), scene_with_truth(tmp_path), cfg, 1, tmp_path)
    assert (np.asarray(Image.open(tmp_path / "test_r_0_moving.png")) > 0).any()
    for name in ("test_r_0_depth.png", "test_r_0_flow.png"):
        picture = np.asarray(Image.open(tmp_path / name))
        assert picture.shape == (32, 3 * 32 + 2 * GAP, 3)
        middle = [picture[16, 16 + (32 + GAP) * part].astype(int) for part in range(3)]
        # Depth and flow are right there: the same colour, and the error's lowest, dark blue and not black
        assert np.abs(middle[0] - middle[1]).max() <= 2 and np.abs(middle[2] - [0, 34, 78]).max() <= 2
