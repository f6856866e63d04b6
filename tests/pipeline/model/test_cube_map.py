"""The cube map against its definition: colours of single directions, continuity, and the gradient at edges."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pipeline.model.cube_map import CubeMap, face_coordinates
from pipeline.model.model import Model, ModelKind
from rasterizer import Camera

RESOLUTION = 5


def random_map(seed: int, resolution: int = RESOLUTION) -> CubeMap:
    return CubeMap(torch.rand(3, 6, resolution, resolution, generator=torch.Generator().manual_seed(seed)))


def looking(direction: np.ndarray, size: int = 1, focal: float = 1.0) -> Camera:
    """A camera at the origin with a middle pixel that looks along `direction`."""
    forward = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    right = np.cross(forward, [0.31, -0.52, 0.79])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    return Camera(size, size, focal, focal, size / 2, size / 2, pose)


def colour(cube: CubeMap, direction: np.ndarray) -> np.ndarray:
    return cube.sample(cube.grid(looking(direction)))[:, 0, 0].numpy()


def directions(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, 3))


def test_a_texel_is_seen_at_its_centre() -> None:
    """Tolerance: float32 positions among 42 rows, 2e-6 of a texel's difference."""
    cube = random_map(0)
    for face in range(6):
        for row, column in ((0, 0), (2, 1), (4, 3)):
            direction = np.empty(3)
            axis, sign = face // 2, -1.0 if face % 2 else 1.0
            direction[axis] = sign
            direction[(axis + 1) % 3] = (2 * column + 1) / RESOLUTION - 1
            direction[(axis + 2) % 3] = (2 * row + 1) / RESOLUTION - 1
            np.testing.assert_allclose(colour(cube, direction), cube.image[:, face, row, column], atol=1e-5)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("along", [-1.0, -0.63, 0.1, 0.8, 1.0])
def test_colours_are_continuous_across_edges_and_corners(axis: int, along: float) -> None:
    """Two directions 2e-4 apart on either side of an edge; a bilinear map changes by at most 5 texels' worth a unit."""
    cube = random_map(1)
    for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        one, other = np.empty(3), np.empty(3)
        for direction, (first, second) in ((one, (1.0, 1.0 - 1e-4)), (other, (1.0 - 1e-4, 1.0))):
            direction[axis] = signs[0] * first
            direction[(axis + 1) % 3] = signs[1] * second
            direction[(axis + 2) % 3] = along
        assert face_coordinates(one)[0] != face_coordinates(other)[0] or abs(along) == 1.0
        np.testing.assert_allclose(colour(cube, one), colour(cube, other), atol=5e-3)


def test_a_constant_map_is_constant_everywhere() -> None:
    cube = CubeMap(torch.full((3, 6, 4, 4), 0.37))
    for direction in directions(50):
        np.testing.assert_allclose(colour(cube, direction), 0.37, atol=1e-6)


def wide_camera(seed: int) -> Camera:
    """Sees several faces, edges and a corner at once."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(None, np.random.default_rng(seed)).as_matrix()
    return Camera(40, 30, 6.0, 6.0, 20.0, 15.0, pose)


@pytest.mark.parametrize("seed", range(6))
def test_the_gradient_is_the_adjoint_of_sampling(seed: int) -> None:
    """Sampling is linear in the texels: <sample(T), W> = <T, gradient(W)> for any T, W, edges and corners included.

    Tolerance: float32 sums of 3600 products.
    """
    cube, camera = random_map(seed, 3), wide_camera(seed)
    grid = cube.grid(camera)
    weights = torch.rand(3, 30, 40, generator=torch.Generator().manual_seed(100 + seed)) - 0.5
    gradient = torch.zeros_like(cube.image)
    cube.add_gradient(gradient, grid, weights)
    forward = (cube.sample(grid).double() * weights).sum().item()
    backward = (cube.image.double() * gradient).sum().item()
    assert forward == pytest.approx(backward, abs=1e-4)


def test_the_gradient_of_single_texels_is_a_finite_difference() -> None:
    """Of corner and edge texels of each face; exact but for float32, because sampling is linear."""
    cube, camera = random_map(0, 2), wide_camera(3)
    grid = cube.grid(camera)
    weights = torch.rand(3, 30, 40, generator=torch.Generator().manual_seed(5))
    gradient = torch.zeros_like(cube.image)
    cube.add_gradient(gradient, grid, weights)
    for face in range(6):
        changed = cube.image.clone()
        changed[1, face, 0, 1] += 1.0
        difference = ((CubeMap(changed).sample(grid) - cube.sample(grid)) * weights).sum().item()
        assert gradient[1, face, 0, 1].item() == pytest.approx(difference, rel=1e-3, abs=1e-3)


def test_it_is_a_background_model_of_six_faces() -> None:
    cube = random_map(0)
    kind = ModelKind("static", 0, 0)
    parameters = {name: torch.zeros(2, *row) for name, row in kind.shapes().items()}
    parameters["quat_left"][:, 0] = 1
    model = Model(kind, parameters, environment_map=cube)
    assert model.background_model == "cubemap"
    assert model.bytes - Model(kind, parameters).bytes == 4 * 3 * 6 * RESOLUTION**2
    copy = model.copy()
    assert isinstance(copy.environment_map, CubeMap) and torch.equal(copy.environment_map.image, cube.image)
    copy.environment_map.image.zero_()
    assert cube.image.sum() > 0


def test_the_same_colours_as_an_equirectangular_map() -> None:
    """Seen by a camera; both maps are bilinear, so a smooth one differs by the curvature between texels."""
    cube = CubeMap.grey(16)
    centre = (2 * torch.arange(16) + 1) / 16 - 1
    for face in range(6):  # colour channel k is ½ + ¼ of the direction's component k
        direction = torch.empty(3, 16, 16)
        direction[face // 2] = -1.0 if face % 2 else 1.0
        direction[(face // 2 + 1) % 3], direction[(face // 2 + 2) % 3] = centre[None, :], centre[:, None]
        cube.image[:, face] = 0.5 + 0.25 * direction / direction.norm(dim=0)
    other, camera = cube.equirectangular(64), wide_camera(2)
    torch.testing.assert_close(other.sample(other.grid(camera)), cube.sample(cube.grid(camera)), atol=0.01, rtol=0)


def test_other_shapes_are_refused() -> None:
    for shape in ((3, 6, 4, 5), (3, 5, 4, 4), (1, 6, 4, 4), (3, 6, 0, 0)):
        with pytest.raises(ValueError, match=r"expected float32 \[3, 6, r, r\]"):
            CubeMap(torch.zeros(shape))
