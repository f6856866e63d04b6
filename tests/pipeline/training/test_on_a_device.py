"""Training and evaluation on a device with gsplat, against the same by the kernel.

The device is pretended, and gsplat's CUDA functions are their PyTorch twins: both refuse what a GPU would.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from gsplat_twins import gsplat_on_the_cpu
from pretended_device import pretended_device
from tiny import TinyRun, tiny_config, tiny_scene

from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.config.train_schema import DensifyConfig, RegularizationConfig
from pipeline.evaluation.quick_evaluate import quick_evaluate
from pipeline.model.initialise import initialise
from pipeline.model.model import Model
from pipeline.training import checkpoint
from pipeline.training.loop import train
from rasterizer import engine_for

pytest.importorskip("gsplat", reason="the extra `gpu` is not installed")
ITERATIONS = 12
DENSIFY = DensifyConfig(
    start=2, stop=11, every=3, space_gradient=1e-5, opacity_reset_every=7, max_gaussians=120,
    prune_sensitivity=0.01, prune_sensitivity_every=5, add_by_error=0.2, add_by_error_every=4,
)  # fmt: skip
KINDS: dict[str, dict] = {
    "rotations": dict(regularization=RegularizationConfig(rigid_released=0.02, opacity=0.001), mse_weight=1.0),
    "sparse": dict(optimiser="sparse_adam", marginal_jitter=0.5),
    "tracks": dict(motion="tracks", regularization=RegularizationConfig(flow=0.1)),
    "trajectories": dict(motion="trajectories", regularization=RegularizationConfig(rigid=0.02)),
}


@pytest.fixture
def device(monkeypatch: pytest.MonkeyPatch) -> Iterator[torch.device]:
    with pretended_device() as device, gsplat_on_the_cpu():
        monkeypatch.setattr("rasterizer.engine.gpu", lambda: device)
        yield device


def config(kind: str, background: str = "none") -> Config:
    keys = dict(batch=1, eval_every=6, densify=DENSIFY, init_points=60)
    return tiny_config(ITERATIONS, background, **keys, **KINDS[kind])


def trained(path: Path, scene: Scene, cfg: Config) -> tuple[Model, list[dict]]:
    """The model, and its evaluations."""
    found: list[dict] = []

    def evaluate_fn(model: Model, progress: object) -> dict:
        found.append(quick_evaluate(model, scene, cfg, engine_for(cfg.backend, 1)))
        return found[-1]

    return train(initialise(scene, cfg, np.random.default_rng(0)), scene, cfg, TinyRun(path), evaluate_fn).model, found


@pytest.mark.parametrize(
    ("kind", "background"), [(kind, "none") for kind in KINDS] + [("rotations", "envmap"), ("rotations", "cubemap")]
)
def test_training_is_that_of_the_kernel_up_to_rounding(kind: str, background: str, device, tmp_path, small_backgrounds):
    scene, cfg = tiny_scene(), config(kind, background)
    expected, by_kernel = trained(tmp_path / "cpu", scene, cfg)
    found, evaluations = trained(tmp_path / "gsplat", scene, replace(cfg, backend="gsplat"))
    assert found.device.type == "cpu" and len(evaluations) == len(by_kernel) == 2
    # Adam turns rounding of tiny gradients into steps, and thresholds of density control turn it into other Gaussians.
    assert abs(len(found) - len(expected)) <= 0.1 * len(expected)
    for one, other in zip(evaluations, by_kernel):
        assert one["psnr"] == pytest.approx(other["psnr"], abs=0.5)


def test_a_run_goes_on_from_a_checkpoint_of_either(device, tmp_path):
    """A checkpoint has nothing of the device."""
    scene, cfg = tiny_scene(), config("rotations")
    half = replace(cfg, train=replace(cfg.train, iterations=6))
    for first, second in (("gsplat", "cpu"), ("cpu", "gsplat")):
        path = tmp_path / first
        trained(path, scene, replace(half, backend=first))
        saved = checkpoint.load(path / checkpoint.FILE_NAME)
        assert saved.iteration == 6 and saved.model.device.type == "cpu"
        trained(path, scene, replace(cfg, backend=second))
        assert checkpoint.load(path / checkpoint.FILE_NAME).iteration == ITERATIONS
