"""The sphere around the scene: even coverage, and which Gaussians Adam updates once it is frozen."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree
from tiny import random_model

from pipeline.model.model import ModelKind
from pipeline.model.sphere import sphere_points, trainable_rows

COUNT, CENTRE, RADIUS = 5000, (3.0, -1.0, 2.0), 7.0


def points(seed: int = 0) -> np.ndarray:
    return sphere_points(COUNT, CENTRE, RADIUS, np.random.default_rng(seed))


def test_all_points_are_on_the_sphere() -> None:
    distance = np.linalg.norm(points() - CENTRE, axis=1)
    np.testing.assert_allclose(distance, RADIUS, rtol=1e-12)  # thousands of float64 rounding errors


def test_points_are_evenly_spaced() -> None:
    """Caps contain their share of the points, and nearest-neighbour distances are nearly equal."""
    found = (points() - CENTRE) / RADIUS
    axes = np.random.default_rng(1).normal(size=(200, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    for height in (0.1, 0.5, 1.0):
        share = (found @ axes.T > 1 - height).mean(axis=0)  # a cap's area is proportional to its height (Archimedes)
        # Measured: at most 0.0022. Independent points deviate by √(share (1-share) / 5000), mostly 0.003 to 0.007.
        assert np.abs(share - height / 2).max() < 0.003
    nearest = cKDTree(found).query(found, k=2)[0][:, 1]
    spacing = np.sqrt(4 * np.pi / COUNT)
    assert 0.8 * spacing < nearest.min() and nearest.max() < 1.05 * spacing, "independent points: 0.01 to 1.6"


def test_the_rotation_depends_on_the_rng() -> None:
    assert np.array_equal(points(0), points(0))
    assert np.abs(points(0) - points(1)).max() > 1.0
    assert sphere_points(1, CENTRE, RADIUS, np.random.default_rng(0)).shape == (1, 3)


def test_trainable_rows_are_the_visible_ones_outside_a_frozen_sphere() -> None:
    model, visible = random_model(ModelKind("static", 0, 0), 4), torch.tensor([1, 1, 0, 0], dtype=torch.uint8)
    assert trainable_rows(model, False, None) is None and trainable_rows(model, False, visible) is visible
    model.sphere = torch.tensor([True, False, True, False])
    assert trainable_rows(model, True, None) is None and trainable_rows(model, True, visible) is visible
    assert trainable_rows(model, False, None).tolist() == [0, 1, 0, 1]
    assert trainable_rows(model, False, visible).tolist() == [0, 1, 0, 0]
    assert trainable_rows(model, False, visible).dtype == torch.uint8
