"""A scene, a configuration and a run folder small enough to train in seconds; shared by tests of several folders."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from datasets.scene import Scene, View, camera_extent, capture_of
from datasets.settings import SceneConfig
from pipeline.config.schema import AblationConfig, Config, EvaluateConfig, InitConfig
from pipeline.config.train_schema import DensifyConfig, LearningRates, TrainConfig
from pipeline.model.initialise import initialise
from pipeline.model.model import Model, ModelKind
from pipeline.training import schedule, state
from pipeline.training.loop import TrainResult, train
from pipeline.training.reporting import Observer, Progress
from rasterizer import Camera

SIZE = 32


def tiny_scene(views: int = 8, static: bool = False) -> Scene:
    """A red disc, moving to the right unless static, and `views` views by four cameras on an arc in front of it."""
    made = []
    for i in range(views):
        time = 0.0 if static else i / (views - 1)
        angle = 0.3 * (i % 4 - 1.5)
        rotation = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        pose = np.eye(4)
        pose[:3, :3], pose[2, 3] = rotation, 4.0  # looks at the origin from a distance of 4
        camera = Camera(SIZE, SIZE, 40.0, 40.0, SIZE / 2, SIZE / 2, pose)
        y, x = np.mgrid[:SIZE, :SIZE] + 0.5
        disc = (x - (10 + 12 * time)) ** 2 + (y - 16) ** 2 < 36
        image = np.zeros((SIZE, SIZE, 3), np.uint8)
        image[disc] = (220, 60, 30)
        made.append(View(camera, time, image, f"train/r_{i}"))
    return Scene(
        "tiny",
        tuple(made),
        tuple(made[::3]),
        1.0,
        0.0,
        (0.0, 0.0, 0.0),
        camera_extent([view.camera for view in made]),
        (-1.2, 1.2),
        Path("tiny"),
        capture_of(made, made[::3], filmed=False),
    )


def tiny_config(iterations: int = 60, background_model: str = "none", **train_keys) -> Config:
    """60 iterations include every event of a schedule."""
    densify = DensifyConfig(start=5, stop=50, every=10, space_gradient=1e-5, opacity_reset_every=25, max_gaussians=400)
    keys = dict(
        iterations=iterations,
        batch=2,
        eval_every=10,
        checkpoint_every=7,
        orders_at=[15, 30, 45, 30, 40],
        lr=LearningRates(decay_iterations=30_000),  # so that runs of any length begin alike
        densify=densify,
        init_points=200,
    )
    return Config(
        scene=SceneConfig(background_model=background_model),
        init=InitConfig(sphere_points=300),
        ablation=AblationConfig(),
        train=TrainConfig(**(keys | train_keys)),
        threads=1,
    )


def evaluation_config(**keys) -> Config:
    """`tiny_config` without LPIPS and with a single speed pass; keys: of `evaluate`."""
    return replace(tiny_config(), evaluate=EvaluateConfig(**{"lpips": False, "speed_repeats": 1} | keys))


def random_model(kind: ModelKind, count: int = 7) -> Model:
    """Standard normal parameters, always the same."""
    rng = torch.Generator().manual_seed(1)
    return Model(kind, {name: torch.randn(count, *row, generator=rng) for name, row in kind.shapes().items()})


class TinyRun:
    """A minimal pipeline.training.reporting.RunLog."""

    def __init__(self, path: Path) -> None:
        path.mkdir(parents=True, exist_ok=True)
        self.path = path

    def log(self, row: dict) -> None:
        self._append("log.jsonl", row)

    def append_error_vs_time(self, row: dict) -> None:
        self._append("error_vs_time.jsonl", row)

    def rows(self, name: str) -> list[dict]:
        file = self.path / name
        lines = file.read_text().splitlines(keepends=True) if file.exists() else []
        return [
            json.loads(line) for line in lines if line.endswith("\n")
        ]  # a killed process may leave a partial last line

    def truncate_after(self, iteration: int) -> None:
        for name in ("log.jsonl", "error_vs_time.jsonl"):
            kept = [json.dumps(row) + "\n" for row in self.rows(name) if row["iteration"] <= iteration]
            (self.path / name).write_text("".join(kept))

    def _append(self, name: str, row: dict) -> None:
        with open(self.path / name, "a") as file:
            file.write(json.dumps(row) + "\n")


def fake_evaluate(model: Model, progress: Progress) -> dict:
    """A "PSNR" that is a function of the model, so that tests notice a different model."""
    return {"psnr": model.parameters["mean"].double().square().mean().item(), "ssim": 0.5, "test_loss": 0.1}


def train_tiny(
    path: Path, cfg: Config | None = None, scene: Scene | None = None, observers: Sequence[Observer] = ()
) -> TrainResult:
    cfg, scene = cfg or tiny_config(), scene or tiny_scene()
    model = initialise(scene, cfg, np.random.default_rng(cfg.seed))
    return train(model, scene, cfg, TinyRun(path), fake_evaluate, observers=observers)


@contextmanager
def small_background_models() -> Iterator[None]:
    """Background models are trained for 20 iterations, and the environment map has 12 rows."""
    with pytest.MonkeyPatch.context() as patch:  # of its own: a test may undo those of `monkeypatch`
        patch.setattr(schedule, "SPHERE_FREEZE_AFTER", 20)
        patch.setattr(schedule, "MAP_UNTIL", 20)
        patch.setattr(state, "MAP_HEIGHT", 12)
        yield


def train_in_process(path: Path, iterations: int, background_model: str) -> None:
    """The main function of a child process."""
    torch.set_num_threads(1)
    with small_background_models():
        train_tiny(path, tiny_config(iterations, background_model))
