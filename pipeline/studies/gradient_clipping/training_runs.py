"""The training runs of the study: healthy and hostile cases, each with and without clipping."""

from __future__ import annotations

import dataclasses
import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from unittest import mock

import numpy as np
from hydra import compose, initialize_config_dir

from datasets import Scene
from pipeline.config.compose import CONFIG_DIR, register_schema, to_config
from pipeline.config.schema import Config
from pipeline.config.train_schema import LearningRates
from pipeline.data.prepare import prepare
from pipeline.evaluation.quick_evaluate import quick_evaluate
from pipeline.model.initialise import initialise
from pipeline.runs.run_folder import RunFolder
from pipeline.studies.gradient_clipping.clipping_adam import ClippingAdam
from pipeline.training import state as training_state
from pipeline.training.finite_checks import NonFiniteError
from pipeline.training.loop import train
from rasterizer import Rasterizer

QUANTILES = (0.5, 0.9)  # of the norms without clipping: the thresholds
LR_FACTOR = 10.0  # of all learning rates in the hostile case
DECAY = ("decay_iterations", "decay_start", "final_factor")  # keys of train.lr that are no rates


@dataclass(frozen=True)
class Case:
    """A scene to train on, and what is wrong with the training."""

    name: str
    scene: str
    lr_factor: float = 1.0
    noise: bool = False  # one training image is noise

    @property
    def is_healthy(self) -> bool:
        return self.lr_factor == 1.0 and not self.noise


CASES = (
    Case("burst", "synthetic/burst"),
    Case("wheel", "synthetic/wheel"),
    Case(f"wheel, learning rates × {LR_FACTOR:g}", "synthetic/wheel", lr_factor=LR_FACTOR),
    Case("wheel, one image noise", "synthetic/wheel", noise=True),
)


@dataclass(frozen=True)
class Outcome:
    """One training run. PSNR is NaN where a value that is not finite stopped it."""

    psnr: float  # dB, test views, after the last iteration
    norms: dict[str, np.ndarray]  # field or "all" -> (iterations,) norm before clipping
    concentration: float  # fraction of the squared norm in the largest gradients, mean over iterations
    clipped: float  # fraction of the iterations


@dataclass(frozen=True)
class ClippedRuns:
    """The seeds of one case at one threshold."""

    quantile: float
    threshold: float
    outcomes: list[Outcome]


@dataclass(frozen=True)
class CaseRuns:
    """All runs of one case."""

    case: Case
    unclipped: list[Outcome]  # by seed
    clipped: list[ClippedRuns]  # by quantile


def study_config(scene: str, iterations: int, points: int, size: int) -> Config:
    """`train=fast` on one thread; evaluated and saved only at its end."""
    register_schema()
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        return to_config(
            compose(
                "config",
                overrides=[
                    f"scene={scene}",
                    f"scene.size={size}",
                    "train=fast",
                    f"train.init_points={points}",
                    "threads=1",
                    *(f"train.{key}={iterations}" for key in ("iterations", "eval_every", "checkpoint_every")),
                ],
            )
        )


def train_cases(configs: dict[str, Config], seeds: list[int], log: Callable[[str], None]) -> list[CaseRuns]:
    """All runs of all cases. configs: by scene. Thresholds come from the healthy case of the scene, first seed."""
    scenes = {name: prepare(cfg, log).scene for name, cfg in configs.items()}
    thresholds, found = {}, []
    for case in CASES:
        log(f"training: {case.name}")
        run = partial(train_case, case, configs[case.scene], scenes[case.scene])
        unclipped = [run(seed, math.inf) for seed in seeds]
        if case.is_healthy:
            thresholds[case.scene] = np.quantile(unclipped[0].norms["all"], QUANTILES)
        clipped = [
            ClippedRuns(quantile, threshold, [run(seed, float(threshold)) for seed in seeds])
            for quantile, threshold in zip(QUANTILES, thresholds[case.scene], strict=True)
        ]
        found.append(CaseRuns(case, unclipped, clipped))
    return found


def train_case(case: Case, cfg: Config, scene: Scene, seed: int, threshold: float) -> Outcome:
    """One run in a temporary folder. cfg, scene: of the healthy case."""
    norms: list[dict[str, float]] = []
    concentration: list[float] = []
    found: dict[str, float | None] = {"psnr": math.nan}
    adam = partial(ClippingAdam, threshold=threshold, norms=norms, concentration=concentration)
    with tempfile.TemporaryDirectory() as folder, mock.patch.object(training_state, "Adam", adam):
        cfg = replace(with_lr_factor(cfg, case.lr_factor), seed=seed, out=folder)
        scene = with_noise(scene) if case.noise else scene
        # The published results were initialised with this generator, not with random_streams.Stream.INIT.
        model = initialise(scene, cfg, np.random.default_rng(seed))
        with RunFolder(Path(folder), dataclasses.asdict(cfg)) as run:
            try:
                train(
                    model,
                    scene,
                    cfg,
                    run,
                    lambda model, _: found.update(quick_evaluate(model, scene, cfg, Rasterizer(1))) or found,
                )
            except NonFiniteError as error:
                print(f"{case.name}, seed {seed}: {error}", flush=True)
    by_field = {name: np.array([row[name] for row in norms]) for name in norms[0]}
    clipped = float((by_field["all"] > threshold).mean())
    psnr = found["psnr"]
    assert psnr is not None  # every scene of CASES has test views
    return Outcome(psnr, by_field, float(np.mean(concentration)), clipped)


def with_lr_factor(cfg: Config, factor: float) -> Config:
    """All learning rates times `factor`, with the same decay."""
    lr = cfg.train.lr
    values = {f.name: getattr(lr, f.name) for f in dataclasses.fields(LearningRates) if f.name not in DECAY}
    scaled = {name: value * factor for name, value in values.items() if value is not None}
    return replace(cfg, train=replace(cfg.train, lr=replace(lr, **scaled)))


def with_noise(scene: Scene) -> Scene:
    """The scene with its middle training image replaced by black and white noise, the same in every run."""
    middle, rng = len(scene.train) // 2, np.random.default_rng(0)
    view = scene.train[middle]
    noise = np.uint8(255) * rng.integers(0, 2, view.image.shape, dtype=np.uint8)
    return replace(scene, train=(*scene.train[:middle], replace(view, image=noise), *scene.train[middle + 1 :]))
