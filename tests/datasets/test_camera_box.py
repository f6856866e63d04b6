"""The box that cameras see in common, against cones and wedges that are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from datasets.camera_box import are_alike, band_of_depths, box_around_frusta, box_of_cameras
from datasets.scene import USUAL_BOX, Box
from rasterizer.camera import Camera

WIDTH, FOCAL = 200, 250.0  # half of the field of view: atan(0.4)


def looking_at(position: np.ndarray, target: np.ndarray) -> Camera:
    """A camera whose image's middle is the target; world z is up."""
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ position
    return Camera(WIDTH, WIDTH, FOCAL, FOCAL, WIDTH / 2, WIDTH / 2, pose)


def ring(count: int, radius: float, centre: np.ndarray, outwards: bool = False) -> list[Camera]:
    angles = 2 * np.pi * np.arange(count) / count
    places = centre + radius * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    return [looking_at(place, 2 * place - centre if outwards else centre) for place in places]


@pytest.mark.parametrize(("unit", "shift"), [(1.0, 0.0), (1e3, 2e5)])
def test_ring_sees_its_middle(unit: float, shift: float) -> None:
    """On a ring of radius 4 the point (r, 0, 0) is seen by all cameras for r up to 4 sin(atan 0.4) = 1.49.

    Three quarters see more. Above the middle all see z up to 4 · 0.4 = 1.6. A grid's cell is 5 % of the box.
    """
    centre = np.array([shift, -shift, 3 * unit])
    box = box_of_cameras(ring(20, 4 * unit, centre))
    assert box is not None
    low, high = (np.array(corner) - centre for corner in box)
    np.testing.assert_allclose(low, -high, atol=0.1 * unit)  # symmetric
    assert (high[:2] > 1.45 * unit).all() and (high[:2] < 2.2 * unit).all()
    assert 1.5 * unit < high[2] < 2.4 * unit  # beyond the middle the far side's cameras see more


def test_cameras_on_one_side_see_a_bounded_wedge() -> None:
    """Of cameras within 20° at distance 4, depths between a fifth and twice the distance: y from 0.8 - 4 to 4."""
    angles = np.radians(np.linspace(-10, 10, 5))
    cameras = [looking_at(4 * np.array([np.sin(a), -np.cos(a), 0]), np.zeros(3)) for a in angles]
    box = box_of_cameras(cameras)
    assert box is not None
    low, high = map(np.asarray, box)
    assert -3.3 < low[1] < -2 and 3.6 < high[1] < 4.1
    assert 1.6 < high[2] < 3.4  # at depth 8 the image is 3.2 high


def test_none_where_axes_do_not_meet_before_the_cameras() -> None:
    assert box_of_cameras(ring(12, 1.0, np.zeros(3), outwards=True)) is None
    row = [looking_at(np.array([x, 0.0, 0.0]), np.array([x, 10.0, 0.0])) for x in np.linspace(-1, 1, 5)]
    assert box_of_cameras(row) is None
    assert box_of_cameras(row[:1] * 3) is None


def test_an_outlier_and_repeated_views_do_not_count() -> None:
    cameras = ring(12, 4.0, np.zeros(3))
    far = looking_at(np.array([4e3, 0.0, 0.0]), np.array([8e3, 0.0, 0.0]))
    assert box_of_cameras([*cameras, *cameras[:1] * 50, far]) == box_of_cameras(cameras)


def test_band_of_depths_of_a_row_and_of_a_way() -> None:
    """Of a row 2 wide the extent is 1.1, and the band 0.5 to 10 times it; a way ahead is seen from 0.02 on."""
    places = np.linspace(-1, 1, 5)
    row = [looking_at(np.array([x, 0.0, 0.0]), np.array([x, 10.0, 0.0])) for x in places]
    way = [looking_at(np.array([0.0, y, 0.0]), np.array([0.0, 10.0, 0.0])) for y in places]
    np.testing.assert_allclose(band_of_depths(row), (0.55, 11.0))
    np.testing.assert_allclose(band_of_depths(way), (0.022, 11.0))


def test_box_around_frusta_holds_their_corners() -> None:
    """At depth 10 the image of a camera is 8 wide and high."""
    row = [looking_at(np.array([x, 0.0, 0.0]), np.array([x, 10.0, 0.0])) for x in (-1.0, 0.0, 1.0)]
    np.testing.assert_allclose(box_around_frusta(row, 10.0), [(-5, 0, -4), (5, 10, 4)], atol=1e-12)


@pytest.mark.parametrize(
    ("box", "alike"),
    [
        (((-1.6, -1.6, -2.1), (1.6, 1.6, 1.4)), True),  # what D-NeRF's cameras see
        (((-3.3, -2.0, -2.8), (3.3, 2.6, 3.1)), False),
        (((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)), False),
        (((0.0, -1.2, -1.2), (2.4, 1.2, 1.2)), False),
    ],
)
def test_the_usual_cube_is_kept_where_the_cameras_bear_it_out(box: Box, alike: bool) -> None:
    assert are_alike(USUAL_BOX, box) == alike
