"""The environment map against a loop over pixels, and its gradient against the definition of the adjoint."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from builders import camera_looking_at, generator
from torch import Tensor

from pipeline.model.environment_map import EnvironmentMap
from rasterizer import Camera

HEIGHT = 12
# The position does not matter, only the direction. The seam is at -z, the poles are at ±y.
CAMERAS = {
    target: camera_looking_at((0.3, -0.2, 0.5), target=target, focal=20.0)
    for target in [(0.0, 0.0, 9.0), (0.4, 0.1, -9.0), (9.0, 1.0, 1.0), (0.3, 9.0, 0.6), (0.2, -9.0, 0.4)]
}


def naive_sample(image: Tensor, camera: Camera) -> Tensor:
    """(3, H, W) float64: the definition in environment_map.py's docstring, pixel by pixel."""
    image, out = image.double(), torch.zeros(3, camera.height, camera.width, dtype=torch.float64)
    height, width = image.shape[1:]
    for row in range(camera.height):
        for column in range(camera.width):
            ray = [(column + 0.5 - camera.cx) / camera.fx, (row + 0.5 - camera.cy) / camera.fy, 1.0]
            x, y, z = np.linalg.inv(camera.world_to_cam[:3, :3]) @ (ray / np.linalg.norm(ray))
            i = (math.atan2(x, z) / (2 * math.pi) + 0.5) * width - 0.5  # a texel's centre is at a whole number
            j = min(max((math.asin(y) / math.pi + 0.5) * height - 0.5, 0.0), height - 1.0)
            left, above = math.floor(i), math.floor(j)
            for near, texel_column in ((1 - (i - left), left), (i - left, left + 1)):
                for close, texel_row in ((1 - (j - above), above), (j - above, min(above + 1, height - 1))):
                    out[:, row, column] += near * close * image[:, texel_row, texel_column % width]
    return out


def random_map(seed: int, height: int = HEIGHT) -> EnvironmentMap:
    return EnvironmentMap(torch.rand(3, height, 2 * height, generator=generator(seed)))


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=[str(target) for target in CAMERAS])
def test_sampling_is_bilinear_by_direction(camera: Camera) -> None:
    environment_map = random_map(0)
    found = environment_map.sample(environment_map.grid(camera))
    # At 0.05 from a pole, float32 (6e-8) has an azimuth error of about 1e-6 rad, 5e-6 of a texel; texels differ by up
    # to 1.
    torch.testing.assert_close(found.double(), naive_sample(environment_map.image, camera), rtol=0, atol=1e-5)


def test_the_world_axes_are_where_the_docstring_says() -> None:
    image = torch.zeros(3, 100, 200)
    image[0], image[1] = torch.arange(200) + 0.5, (torch.arange(100) + 0.5)[:, None]  # column, row of each texel
    environment_map = EnvironmentMap(image)

    def texel(*direction: float) -> list[float]:
        camera = camera_looking_at((0.0, 0.0, 0.0), width=1, height=1, target=direction)
        return environment_map.sample(environment_map.grid(camera))[:2, 0, 0].tolist()

    assert texel(0, 0, 1) == pytest.approx([100, 50], abs=1e-3)  # float32 of values up to 200
    assert texel(1, 0, 0) == pytest.approx([150, 50], abs=1e-3)
    assert texel(-1, 0, 0) == pytest.approx([50, 50], abs=1e-3)
    assert texel(1, math.sqrt(2), 1) == pytest.approx([125, 75], abs=1e-3)
    assert texel(1e-4, 1, 1e-4)[1] == pytest.approx(99.5, abs=1e-3), "clamped at the centre of the last row"
    for x in (-1e-9, 1e-9):  # halfway between columns 199 and 0, where 1e-5 of a texel is a difference of 0.002
        assert texel(x, 0, -1)[0] == pytest.approx(100, abs=1e-2)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=[str(target) for target in CAMERAS])
def test_the_gradient_is_the_adjoint_of_sampling(camera: Camera) -> None:
    """⟨sample(E), d⟩ = ⟨E, gradient(d)⟩ for any E, because sampling is linear in E; gradients accumulate."""
    environment_map, other = random_map(1), random_map(2)
    d_colors = torch.rand(3, camera.height, camera.width, generator=generator(3))
    start = torch.randn(3, HEIGHT, 2 * HEIGHT, generator=generator(4))
    gradient = start.clone()
    environment_map.add_gradient(gradient, environment_map.grid(camera), d_colors)
    left = (naive_sample(other.image, camera) * d_colors).sum()
    right = (other.image.double() * (gradient - start)).sum()
    # 5000 positive terms, each accurate to 1e-5 (see above)
    assert left.item() == pytest.approx(right.item(), rel=1e-5)


def test_bits_do_not_depend_on_the_number_of_threads() -> None:
    camera, before = camera_looking_at((0, 0, 0), 300, 300, target=(0, 0, 1)), torch.get_num_threads()
    d_colors, found = torch.randn(3, 300, 300, generator=generator(5)), []
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            environment_map = random_map(6, 40)
            grid, gradient = environment_map.grid(camera), torch.zeros_like(environment_map.image)
            environment_map.add_gradient(gradient, grid, d_colors)
            found.append((environment_map.sample(grid), gradient))
    finally:
        torch.set_num_threads(before)
    for other in found[1:]:
        assert all(torch.equal(a, b) and a.any() for a, b in zip(found[0], other))


def test_the_initial_map_is_grey() -> None:
    environment_map = EnvironmentMap.grey(3)
    assert torch.equal(environment_map.image, torch.full((3, 3, 6), 0.5)) and environment_map.bytes == 3 * 3 * 6 * 4


def test_another_shape_or_type_is_refused() -> None:
    for image in (torch.zeros(3, 4, 9), torch.zeros(4, 8), torch.zeros(3, 4, 8, dtype=torch.float64)):
        with pytest.raises(ValueError, match=r"environment map: expected float32 \[3, h, 2h\], found"):
            EnvironmentMap(image)
