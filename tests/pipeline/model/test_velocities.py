"""Velocities, spatial covariances and lifetimes against 4D rotations: the same Gaussians."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from builders import generator, make_request, random_gaussians, render

from pipeline.model.model import Model
from pipeline.model.ply import load_ply, save_ply
from pipeline.model.transformed import in_rotations, in_velocities, rotations_of
from rasterizer.covariance import rotation_3d, scaled_axes
from rasterizer.reference import rasterize

# The parameters are rounded to float32, 6e-8; the 4D covariance of fast Gaussians magnifies that by at most 100 here.
ROUNDING = 1e-5
OUTPUTS = ("color", "alpha", "depth", "flow", "stats")


def covariances(model: Model) -> torch.Tensor:
    axes = scaled_axes(model.gaussians().to(torch.float64))
    return axes @ axes.transpose(1, 2)


def random_model(motion: str, count: int = 40) -> Model:
    return Model.from_gaussians(random_gaussians(count, motion, generator(3)).to(torch.float32))


def test_the_covariance_stays_and_has_a_closed_form():
    """Σ = [[R S² Rᵀ + v vᵀ st², v st²], [vᵀ st², st²]], written out."""
    rotations = random_model("full")
    model = in_velocities(rotations)
    p = {name: tensor.double() for name, tensor in model.parameters.items()}
    variance = (2 * p["log_scale"]).exp()
    turn = rotation_3d(p["quat_left"])
    expected = torch.zeros(len(model), 4, 4, dtype=torch.float64)
    moved = p["velocity"] * variance[:, 3:]
    expected[:, :3, :3] = turn @ torch.diag_embed(variance[:, :3]) @ turn.transpose(1, 2)
    expected[:, :3, :3] += moved[:, :, None] * p["velocity"][:, None, :]
    expected[:, :3, 3] = expected[:, 3, :3] = moved
    expected[:, 3, 3] = variance[:, 3]
    for found in (covariances(rotations), covariances(model), covariances(in_rotations(model))):
        torch.testing.assert_close(found, expected, rtol=ROUNDING, atol=ROUNDING * float(expected.abs().max()))


@pytest.mark.parametrize("motion", ["full", "velocity"])
def test_both_render_the_same(motion):
    """In float64 by the reference implementation, so that only the rounding of the parameters differs."""
    model = random_model(motion)
    other = in_velocities(model) if motion == "full" else in_rotations(model)
    assert other.kind == replace(model.kind, motion="velocity" if motion == "full" else "full")
    request = make_request(outputs=OUTPUTS, flow_dt=0.05)
    images = [render(rasterize, one.gaussians().to(torch.float64), request) for one in (model, other)]
    for name in OUTPUTS:
        expected, found = (getattr(image, name) for image in images)
        # 1e-4 of the largest: a pixel where a contribution is at 1/255 may have it in one of both; none has here
        torch.testing.assert_close(found, expected, rtol=0, atol=1e-4 * float(expected.abs().max()))


@pytest.mark.parametrize("motion", ["static", "separable", "velocity"])
def test_only_rotations_become_velocities(motion):
    model = random_model(motion)
    assert in_velocities(model) is model
    assert motion == "velocity" or in_rotations(model) is model


def test_what_stands_still_has_velocity_zero_and_other_fields_stay():
    gaussians = random_gaussians(5, "full", generator(3)).to(torch.float32)
    identity = torch.tensor([1.0, 0, 0, 0]).repeat(5, 1)
    model = Model.from_gaussians(replace(gaussians, quat_left=identity, quat_right=identity))
    found = in_velocities(model)
    assert found.parameters["velocity"].abs().max() == 0
    # The axes are sorted by length.
    spatial = found.parameters["log_scale"][:, :3].sort(dim=1).values
    torch.testing.assert_close(spatial, gaussians.log_scale[:, :3].sort(dim=1).values, rtol=0, atol=1e-6)
    torch.testing.assert_close(found.parameters["log_scale"][:, 3], gaussians.log_scale[:, 3], rtol=0, atol=1e-6)
    for name in ("mean", "opacity_logit", "sh"):
        assert torch.equal(found.parameters[name], model.parameters[name])


def test_the_largest_speed_of_a_rotation():
    """At most |s_x² - st²| / (2 s_x st), of axes s_x and st tilted by any angle (docs/method.md 5.1)."""
    long, short = 0.3, 0.02
    angle = np.linspace(0, np.pi / 2, 1001)
    cos, sin = torch.from_numpy(np.cos(angle)), torch.from_numpy(np.sin(angle))
    axes = torch.zeros(len(angle), 4, 4, dtype=torch.float64)
    axes[:, 1, 1] = axes[:, 2, 2] = 1
    axes[:, 0, 0], axes[:, 0, 3], axes[:, 3, 0], axes[:, 3, 3] = cos, sin, -sin, cos
    factor = axes * torch.tensor([short, 0.1, 0.1, long], dtype=torch.float64)
    gaussians = random_gaussians(len(angle), "full", generator(1)).to(torch.float32)
    model = Model.from_gaussians(replace(gaussians, **rotations_of(factor)))
    speed = in_velocities(model).parameters["velocity"].norm(dim=1).max()
    assert speed.item() == pytest.approx((long**2 - short**2) / (2 * long * short), rel=1e-3)  # of 1001 angles


def test_a_ply_file_has_rotations(tmp_path):
    model = random_model("velocity")
    save_ply(tmp_path / "model.ply", model)
    found = load_ply(tmp_path / "model.ply")
    assert found.kind.motion == "full"
    expected = covariances(model)
    torch.testing.assert_close(covariances(found), expected, rtol=ROUNDING, atol=ROUNDING * float(expected.abs().max()))
