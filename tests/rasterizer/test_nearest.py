"""Nearest points: against SciPy's k-d tree, for points in odd places, and for any number of threads."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from rasterizer.nearest import nearest


def scattered(count: int, columns: int = 3) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(count).standard_normal((count, columns)).astype(np.float32))


@pytest.mark.parametrize("count", [1, 8, 16, 17, 33, 500, 3000])
@pytest.mark.parametrize("columns", [3, 4])
def test_distances_are_those_of_scipy(count: int, columns: int) -> None:
    """Float32 distances of about 1 against float64."""
    points, k = scattered(count, columns), min(9, count)
    rows = torch.from_numpy(np.random.default_rng(0).integers(0, count, 200))
    index, distance = nearest(points, rows, k, threads=1)
    positions = points[:, :3].double().numpy()
    expected, neighbours = cKDTree(positions).query(positions[rows], k=np.arange(1, k + 1))
    np.testing.assert_allclose(distance, expected, rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(index, neighbours)


def test_the_number_of_threads_changes_no_bit() -> None:
    points, rows = scattered(2000), torch.arange(2000)
    one, three = (nearest(points, rows, 9, threads) for threads in (1, 3))
    assert torch.equal(one[0], three[0]) and torch.equal(one[1], three[1])


@pytest.mark.parametrize("far", [1e30, np.inf, np.nan])
def test_points_in_odd_places(far: float) -> None:
    """Many in one place, on a line, and one that is far, infinite or not a number: the others are found as ever."""
    points = torch.zeros(101, 3)
    points[40:100, 1] = torch.arange(60.0)
    points[100] = far
    index, distance = nearest(points, torch.tensor([0, 99]), 4, threads=1)
    assert distance.tolist() == [[0, 0, 0, 0], [0, 1, 2, 3]]
    assert index[1].tolist() == [99, 98, 97, 96]


@pytest.mark.parametrize(
    ("points", "rows", "k", "message"),
    [
        (torch.zeros(5, 2), torch.tensor([0]), 1, r"points must be \(N, 3\) or more columns, got \[5, 2\]"),
        (torch.zeros(5, 3, dtype=torch.float64), torch.tensor([0]), 1, "points must be contiguous float32"),
        (torch.zeros(5, 3), torch.tensor([0], dtype=torch.int32), 1, "rows must be contiguous int64"),
        (torch.zeros(5, 3), torch.tensor([0]), 6, r"k must be in 1\.\.5, the number of points, got 6"),
        (torch.zeros(5, 3), torch.tensor([2, 5]), 1, r"rows must be in 0\.\.4, got 2 to 5"),
    ],
)
def test_wrong_arguments_are_refused(points: torch.Tensor, rows: torch.Tensor, k: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        nearest(points, rows, k)
