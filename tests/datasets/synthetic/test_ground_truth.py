"""Ground truth read from files: units, crops and other sizes, against loops."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from datasets.files.errors import SceneError
from datasets.ground_truth import GroundTruth, StoredTruth, any_moving

HEIGHT, WIDTH = 7, 10


def random_truth() -> GroundTruth:
    rng = np.random.default_rng(0)
    return GroundTruth(
        moving=rng.random((HEIGHT, WIDTH)) < 0.15,
        depth=rng.uniform(1, 5, (HEIGHT, WIDTH)).astype(np.float32),
        flow=rng.normal(size=(2, HEIGHT, WIDTH)).astype(np.float32),
        flow_valid=rng.random((HEIGHT, WIDTH)) < 0.8,
        flow_dt=0.1,
    )


def write(path: Path, truth: GroundTruth) -> Path:
    np.savez(path, **{name: value for name, value in vars(truth).items() if value is not None})
    return path


@pytest.mark.parametrize("width, height", [(5, 7), (4, 3), (10, 2), (7, 5), (1, 1)])
def test_a_pixel_moves_if_any_that_it_covers_does(width: int, height: int) -> None:
    moving = random_truth().moving
    assert moving is not None
    expected = np.zeros((height, width), bool)
    for row in range(HEIGHT):
        for column in range(WIDTH):
            if moving[row, column]:
                for y in range(height):
                    for x in range(width):  # in units of 1/(old · new): integers, so that edges are exact
                        over = min((x + 1) * WIDTH, (column + 1) * width) > max(x * WIDTH, column * width)
                        down = min((y + 1) * HEIGHT, (row + 1) * height) > max(y * HEIGHT, row * height)
                        expected[y, x] |= over and down
    np.testing.assert_array_equal(any_moving(moving, width, height), expected)


def test_downscaling_takes_the_middle_and_scales_the_flow(tmp_path: Path) -> None:
    """Blocks of 3 x 3 have a middle pixel; the row and the column that fill no block are left out."""
    truth = random_truth()
    small = StoredTruth(write(tmp_path / "a.npz", truth), downscale=3).read()
    assert truth.depth is not None and truth.flow is not None and truth.flow_valid is not None
    np.testing.assert_array_equal(small.depth, truth.depth[1:6:3, 1:9:3])
    np.testing.assert_allclose(small.flow, truth.flow[:, 1:6:3, 1:9:3] / 3, rtol=1e-6)
    np.testing.assert_array_equal(small.flow_valid, truth.flow_valid[1:6:3, 1:9:3])
    assert small.moving is not None and small.moving.shape == (2, 3) and truth.moving is not None
    for y in range(2):
        for x in range(3):
            assert small.moving[y, x] == truth.moving[3 * y : 3 * y + 3, 3 * x : 3 * x + 3].any()


def test_units_of_the_scene(tmp_path: Path) -> None:
    truth = random_truth()
    stored = StoredTruth(write(tmp_path / "a.npz", truth)).in_units(2.0, 3.0).in_units(5.0, 0.5)
    found = stored.read()
    np.testing.assert_allclose(found.depth, 10 * truth.depth, rtol=1e-6)
    assert found.flow_dt == pytest.approx(0.15)
    np.testing.assert_array_equal(found.flow, truth.flow)


def test_what_a_file_lacks_is_unknown(tmp_path: Path) -> None:
    found = StoredTruth(write(tmp_path / "a.npz", GroundTruth(depth=random_truth().depth))).read()
    assert (found.moving, found.flow, found.flow_valid, found.flow_dt) == (None, None, None, None)
    assert found.depth is not None


@pytest.mark.parametrize("content", [b"", b"text", b"PK\x03\x04 cut short"])
def test_a_damaged_file_is_named(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(SceneError, match=r"a\.npz"):
        StoredTruth(tmp_path / "a.npz").read()
