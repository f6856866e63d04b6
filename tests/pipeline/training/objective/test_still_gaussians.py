"""Long-lived Gaussians are held still: by the closed form of the velocity, and in a training."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from builders import random_gaussians
from tiny import tiny_config, tiny_scene

from pipeline.config.random_streams import Stream, stream
from pipeline.config.train_schema import RegularizationConfig
from pipeline.model.initialise import initialise
from pipeline.model.model import Model
from pipeline.model.tilt import tilt
from pipeline.model.transformed import in_velocities
from pipeline.training.loop import train
from pipeline.training.objective.still_gaussians import hold_still
from pipeline.training.reporting import temporary_run
from rasterizer.covariance import scaled_axes

LIFETIME = 0.5
# float32 quaternions of unit length: their products, and so the tilt, are exact to a few roundings of 6e-8.
ROUNDING = 1e-6


def model(lifetimes: tuple[float, ...]) -> Model:
    """Gaussians of random rotations with these st."""
    gaussians = random_gaussians(len(lifetimes), "full", torch.Generator().manual_seed(5))
    found = Model.from_gaussians(gaussians.to(torch.float32))
    found.parameters["log_scale"][:, 3] = torch.tensor(lifetimes).log()
    return found


def covariances(found: Model) -> torch.Tensor:
    """(N, 4, 4) Σ = R diag(s)² Rᵀ."""
    axes = scaled_axes(found.gaussians())
    return axes @ axes.mT


def velocity(found: Model) -> torch.Tensor:
    """(N, 3) Σ_xt / σ_t², the velocity of the conditional mean."""
    covariance = covariances(found)
    return covariance[:, :3, 3] / covariance[:, 3, 3:]


def test_the_long_lived_stop_and_the_others_keep_their_velocity() -> None:
    found = model((0.1, 0.49, 0.51, 3.0))
    before = velocity(found)
    assert (before.norm(dim=1) > 0.01).all()
    hold_still(found, LIFETIME)
    assert torch.equal(velocity(found)[:2], before[:2])
    assert velocity(found)[2:].norm(dim=1).max() < ROUNDING


def test_velocities_of_the_long_lived_become_zero() -> None:
    found = in_velocities(model((0.1, 3.0)))
    found.parameters["log_scale"][:, 3] = torch.tensor([0.49, 0.51]).log()
    before = found.parameters["velocity"].clone()
    hold_still(found, LIFETIME)
    assert torch.equal(found.parameters["velocity"], before * torch.tensor([[1.0], [0.0]]))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_still_gaussian_stays_as_it_is(sign: float) -> None:
    """Its covariance, whose rotation is the same for qr and -qr."""
    found = model((2.0, 2.0, 2.0))
    hold_still(found, LIFETIME)
    before = covariances(found)
    found.parameters["quat_right"] *= sign
    hold_still(found, LIFETIME)
    torch.testing.assert_close(covariances(found), before, rtol=ROUNDING, atol=ROUNDING)
    assert tilt(found.parameters["quat_left"], found.parameters["quat_right"]).max() < ROUNDING


def test_no_other_pair_without_tilt_is_nearer() -> None:
    """The distance of (ql, qr) to the result against that to 1,000 random pairs without tilt."""
    found = model((1.0,))
    of_left, of_right = (torch.nn.functional.normalize(found.parameters[f"quat_{side}"]) for side in ("left", "right"))
    flip = torch.tensor([1.0, 1.0, 1.0, -1.0])

    def distance(left: torch.Tensor) -> torch.Tensor:
        right = left * flip
        of_sign = [(right - s * of_right).square().sum(dim=1) for s in (1, -1)]
        return (left - of_left).square().sum(dim=1) + torch.minimum(*of_sign)

    others = torch.nn.functional.normalize(torch.randn(1000, 4, generator=torch.Generator().manual_seed(0)))
    hold_still(found, LIFETIME)
    assert distance(found.parameters["quat_left"])[0] <= distance(others).min() + ROUNDING


def test_in_a_training_only_the_short_lived_move() -> None:
    """Lifetimes around the limit: half of the initial Gaussians are above it."""
    scene, cfg = tiny_scene(12), tiny_config(20, regularization=RegularizationConfig(still_lifetime=LIFETIME))
    cfg = replace(cfg, ablation=replace(cfg.ablation, rotation_4d=True))
    initial = initialise(scene, cfg, stream(cfg.seed, Stream.INIT))
    initial.parameters["log_scale"][::2, 3] = torch.tensor(LIFETIME * scene.duration * 4).log()
    with temporary_run() as run:
        trained = train(initial, scene, cfg, run, lambda *_: {"psnr": 0.0}).model
    speed = velocity(trained).norm(dim=1)
    long_lived = trained.parameters["log_scale"][:, 3].exp() > LIFETIME * scene.duration
    assert long_lived.any() and speed[long_lived].max() < ROUNDING
    assert (speed[~long_lived] > 1e-4).any()
