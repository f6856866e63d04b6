"""The reference implementation's equations, one by one, against textbook formulas, SciPy and hand calculation.

`test_reference_image.py` tests whole images. All in float64, where correct formulas differ by rounding alone: 1e-10
relative leaves room for sums.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.special
import torch
from builders import generator, off_centre_camera, quaternion_product, random_gaussians

from rasterizer.camera import Camera
from rasterizer.covariance import (
    normalise_quaternion,
    rotation_3d,
    rotation_4d,
    scaled_axes,
    temporal_deviation,
    time_row,
)
from rasterizer.gaussians import Gaussians
from rasterizer.reference import render as reference
from rasterizer.reference.sh import sh_basis


def covariance_4d(gaussians: Gaussians) -> torch.Tensor:
    axes = scaled_axes(gaussians)
    return axes @ axes.mT


# ---- The 4D Gaussian ---------------------------------------------------------------------------------------


def test_rotations_are_orthogonal_with_determinant_1():
    left, right = torch.randn(2, 50, 4, generator=generator(0), dtype=torch.float64)
    for matrix in (rotation_4d(left, right), rotation_3d(left)):
        identity = torch.eye(matrix.shape[-1], dtype=torch.float64).expand_as(matrix)
        torch.testing.assert_close(matrix @ matrix.mT, identity, rtol=0, atol=1e-12)
        torch.testing.assert_close(torch.linalg.det(matrix), torch.ones(50, dtype=torch.float64))


def test_identity_quaternions_give_the_identity():
    one = torch.tensor([[1.0, 0, 0, 0]], dtype=torch.float64)
    assert torch.equal(rotation_4d(one, one)[0], torch.eye(4, dtype=torch.float64))
    assert torch.equal(rotation_3d(one)[0], torch.eye(3, dtype=torch.float64))


def test_rotation_4d_multiplies_by_quaternions_on_both_sides():
    left, right, vector = torch.randn(3, 20, 4, generator=generator(1), dtype=torch.float64)
    unit = lambda q: q / q.norm(dim=-1, keepdim=True)  # noqa: E731
    expected = quaternion_product(quaternion_product(unit(left), vector), unit(right))
    rotated = (rotation_4d(left, right) @ vector[:, :, None])[:, :, 0]
    torch.testing.assert_close(rotated, expected, rtol=1e-12, atol=1e-12)


def test_time_row_is_the_last_row_of_the_rotation():
    left, right = torch.randn(2, 20, 4, generator=generator(3), dtype=torch.float64)
    torch.testing.assert_close(time_row(left, right), rotation_4d(left, right)[:, 3], rtol=0, atol=1e-14)


@pytest.mark.parametrize("motion", ["full", "separable"])
def test_temporal_deviation_is_the_square_root_of_the_covariance(motion):
    gaussians = random_gaussians(30, motion, generator(4))
    expected = covariance_4d(gaussians)[:, 3, 3].sqrt()
    torch.testing.assert_close(temporal_deviation(gaussians), expected, rtol=1e-12, atol=0)


def test_rotation_3d_conjugates_by_the_quaternion():
    quat, vector = torch.randn(2, 20, 4, generator=generator(2), dtype=torch.float64)
    unit = quat / quat.norm(dim=-1, keepdim=True)
    pure = vector * torch.tensor([0, 1, 1, 1])
    expected = quaternion_product(quaternion_product(unit, pure), unit * torch.tensor([1, -1, -1, -1]))
    torch.testing.assert_close((rotation_3d(quat) @ pure[:, 1:, None])[:, :, 0], expected[:, 1:])


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_quaternions_of_any_norm_are_normalised(dtype: torch.dtype):
    quat = torch.tensor([[3e-30, 4e-30, 0, 0], [3e30, 4e30, 0, 0], [0, 0, 0, 0]], dtype=dtype, requires_grad=True)
    unit = normalise_quaternion(quat)
    expected = torch.tensor([[0.6, 0.8, 0, 0], [0.6, 0.8, 0, 0], [1, 0, 0, 0]], dtype=dtype)
    torch.testing.assert_close(unit, expected)
    unit[:, 0].sum().backward()
    assert torch.isfinite(quat.grad).all() and torch.equal(quat.grad[2], torch.zeros(4, dtype=dtype))


@pytest.mark.parametrize("motion", ["full", "separable"])
def test_the_slice_factorizes_the_4d_density(motion: str):
    """p(x, y, z, t) = p(t) p(x, y, z | t), the left side with the full 4×4 covariance."""
    gaussians = random_gaussians(40, motion, generator(3))
    instant = 0.4
    offset = torch.randn(40, 3, generator=generator(4), dtype=torch.float64) * 0.1
    sliced = reference.slice_in_time(gaussians, instant)
    point = torch.cat([sliced.mean + offset, torch.full((40, 1), instant, dtype=torch.float64)], dim=1)
    deviation = point - gaussians.mean
    log_joint = -0.5 * torch.einsum("ni,nij,nj->n", deviation, torch.linalg.inv(covariance_4d(gaussians)), deviation)
    conditional = sliced.factor @ sliced.factor.mT
    log_given_time = -0.5 * torch.einsum("ni,nij,nj->n", offset, torch.linalg.inv(conditional), offset)
    # The two inverses have condition numbers up to 1e3: 1e-9 is 1e4 roundings of them.
    torch.testing.assert_close(log_joint, sliced.marginal.log() + log_given_time, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("motion", ["full", "separable"])
def test_the_slice_matches_the_textbook_conditional_gaussian(motion: str):
    gaussians = random_gaussians(40, motion, generator(5))
    sigma, instant = covariance_4d(gaussians), 0.7
    sliced = reference.slice_in_time(gaussians, instant)
    across, elapsed = sigma[:, :3, 3], instant - gaussians.mean[:, 3]
    schur = sigma[:, :3, :3] - across[:, :, None] * across[:, None, :] / sigma[:, 3, 3, None, None]
    torch.testing.assert_close(sliced.factor @ sliced.factor.mT, schur, rtol=1e-10, atol=1e-12)
    torch.testing.assert_close(sliced.variance_t, sigma[:, 3, 3])
    torch.testing.assert_close(sliced.velocity, across / sigma[:, 3, 3, None], rtol=1e-10, atol=1e-12)
    torch.testing.assert_close(sliced.mean, gaussians.mean[:, :3] + sliced.velocity * elapsed[:, None])


def test_a_rotation_in_the_x_t_plane_moves_along_x():
    """By hand: R rotates e_x towards e_t by θ, so Σxt = sinθ cosθ (sx² - st²), Σtt = sin²θ sx² + cos²θ st²."""
    theta, sx, st = 0.6, 0.3, 0.5
    quaternion = torch.tensor([[math.cos(theta / 2), 0, 0, math.sin(theta / 2)]], dtype=torch.float64)
    gaussians = Gaussians(
        torch.zeros(1, 4).double(),
        torch.tensor([[sx, 0.1, 0.1, st]]).double().log(),
        quaternion,
        quaternion,
        torch.zeros(1).double(),
        torch.zeros(1, 1, 3).double(),
    )
    sxt = math.sin(theta) * math.cos(theta) * (sx**2 - st**2)
    stt = (math.sin(theta) * sx) ** 2 + (math.cos(theta) * st) ** 2
    velocity = reference.slice_in_time(gaussians, 0.2).velocity[0]
    torch.testing.assert_close(velocity, torch.tensor([sxt / stt, 0, 0], dtype=torch.float64))


# ---- Projection and colour ---------------------------------------------------------------------------------


@pytest.mark.parametrize("columns", [3, 4])
def test_the_ellipse_form_equals_the_inverse_of_the_dilated_covariance(columns: int):
    factor = torch.randn(30, 2, columns, generator=generator(6), dtype=torch.float64) * 5
    covariance = factor @ factor.mT + 0.3 * torch.eye(2, dtype=torch.float64)
    k, v, c = reference.ellipse(factor).unbind(1)
    inverse = torch.stack([1 / v, k / v, k / v, k**2 / v + 1 / c], dim=1)
    torch.testing.assert_close(inverse.reshape(-1, 2, 2), torch.linalg.inv(covariance), rtol=1e-9, atol=1e-12)
    torch.testing.assert_close(v * c, torch.linalg.det(covariance), rtol=1e-8, atol=0)


def test_the_jacobian_is_the_derivative_of_the_projection_inside_the_frustum():
    camera = replace(off_centre_camera(), world_to_cam=np.eye(4))
    points = torch.tensor([[0.1, -0.2, 2.0], [-0.5, 0.3, 3.0]], dtype=torch.float64)
    identity = torch.eye(3, dtype=torch.float64).expand(2, 3, 3)
    for point, found in zip(points, reference.project_factor(identity, points, camera)):
        expected = torch.func.jacrev(lambda p: reference.project_point(p[None], camera)[0])(point)
        torch.testing.assert_close(found, expected)


def test_the_jacobian_is_clamped_on_each_side_of_the_principal_point():
    camera = Camera(100, 80, 50.0, 40.0, 20.0, 60.0, np.eye(4))
    points = torch.tensor([[-1000.0, -1000, 1], [1000, 1000, 1]], dtype=torch.float64)
    found = reference.project_factor(torch.eye(3, dtype=torch.float64).expand(2, 3, 3), points, camera)[:, :, 2]
    # -f u/z with u = 1.3 × (-20, -60)/f, then 1.3 × (100 - 20, 80 - 60)/f
    torch.testing.assert_close(found, -1.3 * torch.tensor([[-20.0, -60], [80, 20]], dtype=torch.float64))


def test_sh_basis_matches_scipy_with_the_condon_shortley_phase():
    """Real Y_lm = √2 Im Y_l^|m| for m < 0, Y_l^0, √2 Re Y_l^m for m > 0: 3D Gaussian Splatting's signs."""
    direction = torch.nn.functional.normalize(torch.randn(60, 3, generator=generator(7), dtype=torch.float64), dim=-1)
    x, y, z = direction.numpy().T
    polar, azimuth = np.arccos(z), np.arctan2(y, x)
    expected = []
    for degree in range(4):
        for m in range(-degree, degree + 1):
            value = scipy.special.sph_harm_y(degree, abs(m), polar, azimuth)
            expected.append(value.real if m == 0 else math.sqrt(2) * (value.real if m > 0 else value.imag))
    torch.testing.assert_close(sh_basis(direction, 3), torch.from_numpy(np.stack(expected, axis=1)), rtol=0, atol=1e-12)


def test_sh_constants_are_those_of_3d_gaussian_splatting():
    """C0 and C1 as printed in its program, so that its .ply files have the same meaning here."""
    c0, c1 = 0.28209479177387814, 0.4886025119029199
    found = sh_basis(torch.eye(3, dtype=torch.float64), 1)
    expected = torch.tensor([[c0, 0, 0, -c1], [c0, -c1, 0, 0], [c0, 0, c1, 0]], dtype=torch.float64)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-15)
