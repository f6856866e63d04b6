"""Long-lived Gaussians are held still, alone and in a training."""

from __future__ import annotations

import torch
from builders import random_gaussians
from tiny import tiny_config, tiny_scene

from pipeline.config.random_streams import Stream, stream
from pipeline.config.train_schema import RegularizationConfig
from pipeline.model.initialise import initialise
from pipeline.model.model import Model
from pipeline.model.transformed import in_velocities
from pipeline.training.loop import train
from pipeline.training.objective.still_gaussians import hold_still
from pipeline.training.reporting import temporary_run
from rasterizer.covariance import scaled_axes

LIFETIME = 0.5


def test_velocities_of_the_long_lived_become_zero() -> None:
    gaussians = random_gaussians(2, "full", torch.Generator().manual_seed(5))
    found = in_velocities(Model.from_gaussians(gaussians.to(torch.float32)))
    found.parameters["log_scale"][:, 3] = torch.tensor([0.49, 0.51]).log()
    before = found.parameters["velocity"].clone()
    assert (before != 0).all()
    hold_still(found, LIFETIME)
    assert torch.equal(found.parameters["velocity"], before * torch.tensor([[1.0], [0.0]]))


def test_in_a_training_only_the_short_lived_move() -> None:
    """Lifetimes around the limit: half of the initial Gaussians are above it."""
    rules = RegularizationConfig(still_lifetime=LIFETIME)
    scene, cfg = tiny_scene(12), tiny_config(20, motion="tracks", regularization=rules)
    initial = initialise(scene, cfg, stream(cfg.seed, Stream.INIT))
    initial.parameters["log_scale"][::2, 3] = torch.tensor(LIFETIME * scene.duration * 4).log()
    with temporary_run() as run:
        trained = train(initial, scene, cfg, run, lambda *_: {"psnr": 0.0}).model
    axes = scaled_axes(trained.gaussians())
    covariance = axes @ axes.mT  # (N, 4, 4) Σ
    speed = (covariance[:, :3, 3] / covariance[:, 3, 3:]).norm(dim=1)  # of the conditional mean
    long_lived = covariance[:, 3, 3].sqrt() > LIFETIME * scene.duration
    # 1e-6: rounding of float32 rotations, of covariances of about 1
    assert long_lived.any() and speed[long_lived].max() < 1e-6
    assert (speed[~long_lived] > 1e-4).any()
