"""Would clipping gradients help? Measures how heavy-tailed they are, and trains with and without it.

    .venv/bin/python pipeline/studies/gradient_clipping.py                    # writes results/measured/clipping.md

The pipeline clips nothing. Here its Adam is replaced by one that scales the whole gradient down to a threshold where
its norm is above, the threshold a quantile of the norms in a run without: on two healthy scenes, with learning rates
ten times too high, and with one training image of black and white noise.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import shlex
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from unittest import mock

import numpy as np
import torch
from torch import Tensor

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from hydra import compose, initialize_config_dir  # noqa: E402

from datasets import Scene  # noqa: E402
from datasets.files.atomic_write import write_text  # noqa: E402
from pipeline.config.compose import CONFIG_DIR, register_schema, to_config  # noqa: E402
from pipeline.config.schema import Config  # noqa: E402
from pipeline.config.train_schema import LearningRates  # noqa: E402
from pipeline.data.prepare import prepare  # noqa: E402
from pipeline.evaluation.evaluate import quick_evaluate  # noqa: E402
from pipeline.model.initialise import initialise  # noqa: E402
from pipeline.presentation.seeds import compare, estimate  # noqa: E402
from pipeline.presentation.table import measured  # noqa: E402
from pipeline.runs.provenance import provenance  # noqa: E402
from pipeline.runs.run_folder import RunFolder  # noqa: E402
from pipeline.training import loop as training  # noqa: E402
from pipeline.training.finite_checks import NonFiniteError  # noqa: E402
from pipeline.training.optimiser import Adam  # noqa: E402
from rasterizer import Gradients, Rasterizer  # noqa: E402

QUANTILES = (0.5, 0.9)  # of the norms without clipping: what is above is scaled down to it
BEFORE = 50  # iterations whose median a norm is compared with, to see spikes
HOT = 0.01  # part of the Gaussians, those with the largest gradients
FASTER = 10.0  # × the learning rates, in the hostile case


@dataclass(frozen=True)
class Case:
    """What is trained, and what is wrong with it."""

    name: str
    scene: str
    faster: float = 1.0  # × all learning rates
    noise: bool = False  # one training image is noise

    @property
    def is_healthy(self) -> bool:
        return self.faster == 1.0 and not self.noise


CASES = (
    Case("burst", "synthetic/burst"),
    Case("wheel", "synthetic/wheel"),
    Case(f"wheel, rates × {FASTER:g}", "synthetic/wheel", faster=FASTER),
    Case("wheel, one image noise", "synthetic/wheel", noise=True),
)


@dataclass(frozen=True)
class Outcome:
    """One run. PSNR NaN: training stopped at a number that is not finite."""

    psnr: float  # dB, test views, after the last iteration
    norms: dict[str, np.ndarray]  # field or "all" -> (iterations,) norm before clipping
    hot: float  # part of the squared norm that the HOT Gaussians have, mean over iterations
    clipped: float  # part of the iterations


class ClippingAdam(Adam):
    """Adam that first scales the gradient of all parameters together down to norm `threshold`, and keeps the norms."""

    def __init__(self, model, threads: int, threshold: float, norms: list[dict[str, float]], hot: list[float]) -> None:
        super().__init__(model, threads)
        self._threshold, self._norms, self._hot = threshold, norms, hot

    def step(self, gradients: Gradients, *arguments) -> None:
        squares = squares_of(gradients)
        found = {name: math.sqrt(rows.sum().item()) for name, rows in squares.items()}
        self._norms.append(found)
        rows = squares["all"]
        top = rows.topk(max(1, int(HOT * len(rows)))).values.sum().item()
        self._hot.append(top / max(rows.sum().item(), sys.float_info.min))
        if found["all"] > self._threshold:
            scale_(gradients, self._threshold / found["all"])
        super().step(gradients, *arguments)


def squares_of(gradients: Gradients) -> dict[str, Tensor]:
    """(N,) squared norm of each Gaussian's gradient, float64, by field and of "all" fields."""
    fields = gradients.dense() | {"sh": gradients.sh()}
    norms = {name: torch.linalg.vector_norm(g.reshape(len(g), -1), dim=1) for name, g in fields.items()}
    squares = {name: norm.double().square() for name, norm in norms.items()}
    return squares | {"all": sum(squares.values())}


def scale_(gradients: Gradients, factor: float) -> None:
    """All of them, in place; those of the coefficients are linear in the colours' that stand for them."""
    for tensor in gradients.dense().values():
        tensor.mul_(factor)
    for view in gradients.views:
        view.gradient[:, :3].mul_(factor)


def config_of(scene: str, iterations: int, points: int, size: int) -> Config:
    """`train=fast` on one thread, evaluated and saved at its end only."""
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


def with_rates(cfg: Config, factor: float) -> Config:
    """All learning rates times `factor`; how they decay stays."""
    learning_rates = {
        f.name: getattr(cfg.train.lr, f.name) * factor
        for f in dataclasses.fields(LearningRates)
        if f.name not in ("decay_iterations", "final_factor")
    }
    return replace(cfg, train=replace(cfg.train, lr=replace(cfg.train.lr, **learning_rates)))


def with_noise(scene: Scene) -> Scene:
    """The middle training image black and white at random: the largest contrast that a file can hold."""
    middle, generator = len(scene.train) // 2, np.random.default_rng(0)  # the same picture in every run
    view = scene.train[middle]
    noise = np.uint8(255) * generator.integers(0, 2, view.image.shape, dtype=np.uint8)
    return replace(scene, train=(*scene.train[:middle], replace(view, image=noise), *scene.train[middle + 1 :]))


def outcome_of(case: Case, cfg: Config, scene: Scene, seed: int, threshold: float) -> Outcome:
    """Trains once, in a folder that is thrown away. cfg, scene: as they would be if nothing were wrong."""
    norms, hot, found = [], [], {"psnr": math.nan}
    adam = partial(ClippingAdam, threshold=threshold, norms=norms, hot=hot)
    with tempfile.TemporaryDirectory() as folder, mock.patch.object(training, "Adam", adam):
        cfg = replace(with_rates(cfg, case.faster), seed=seed, out=folder)
        scene = with_noise(scene) if case.noise else scene
        model = initialise(scene, cfg, np.random.default_rng(seed))  # as the published study was made, not Stream.INIT
        with RunFolder(Path(folder), dataclasses.asdict(cfg)) as run:
            try:
                training.train(
                    model,
                    scene,
                    cfg,
                    run,
                    lambda model, _: found.update(quick_evaluate(model, scene, cfg, Rasterizer(1))) or found,
                )
            except NonFiniteError as error:
                print(f"{case.name}, seed {seed}: {error}", flush=True)
    by_field = {name: np.array([row[name] for row in norms]) for name in norms[0]}
    return Outcome(found["psnr"], by_field, float(np.mean(hot)), float((by_field["all"] > threshold).mean()))


def spike(norms: np.ndarray) -> float:
    """The largest ratio of a norm to the median of the BEFORE norms before it."""
    medians = np.median(np.lib.stride_tricks.sliding_window_view(norms, BEFORE)[:-1], axis=1)
    return float((norms[BEFORE:] / medians).max())


def tails(name: str, outcome: Outcome) -> list[str]:
    """A row a field: how far the norms of the iterations lie above their median."""
    rows = []
    for field, norms in outcome.norms.items():
        middle, ninety, ninety_nine = np.quantile(norms, (0.5, 0.9, 0.99))
        rows.append(
            f"| {name} | {field} | {middle:.2e} | {ninety / middle:.1f} | {ninety_nine / middle:.1f} | "
            f"{norms.max() / middle:.1f} | {spike(norms):.1f} |"
        )
    return [*rows, f"| {name} | {outcome.hot:.0%} of its square is of {HOT:.0%} of the Gaussians | | | | | |"]


def study(
    configs: dict[str, Config], seeds: list[int], log: Callable[[str], None]
) -> tuple[list[str], list[str], list[str]]:
    """Rows of the two tables, and where clipping helped. configs: by scene."""
    of_norms, of_runs, helped, thresholds = [], [], [], {}
    scenes = {name: prepare(cfg, log).scene for name, cfg in configs.items()}
    for case in CASES:
        train = partial(outcome_of, case, configs[case.scene], scenes[case.scene])
        plain = [train(seed, math.inf) for seed in seeds]
        if case.is_healthy:
            rows = tails(case.name, plain[0])
            log("\n".join(rows))
            of_norms += rows
            thresholds[case.scene] = np.quantile(plain[0].norms["all"], QUANTILES)
        of_runs.append(f"| {case.name} | none | | {psnr_text(plain)} | | |")
        log(of_runs[-1])
        for quantile, threshold in zip(QUANTILES, thresholds[case.scene], strict=True):
            runs = [train(seed, float(threshold)) for seed in seeds]
            gain, word = verdict(runs, plain)
            if word == "better":
                helped.append(f"{case.name}, above {quantile:.0%}")
            clipped = np.mean([o.clipped for o in runs])
            of_runs.append(
                f"| {case.name} | {quantile:.0%}: {threshold:.2e} | {clipped:.0%} | {psnr_text(runs)} | "
                f"{gain} | {word} |"
            )
            log(of_runs[-1])
    return of_norms, of_runs, helped


def verdict(runs: list[Outcome], plain: list[Outcome]) -> tuple[str, str]:
    """(gain of `runs` over `plain` in dB, better | worse | …), by the rule of the report's ablations."""
    stopped, before = (sum(math.isnan(o.psnr) for o in outcomes) for outcomes in (runs, plain))
    if stopped or before:
        return "n/a", "better" if stopped < before else "worse" if stopped > before else "no difference shown"
    found = compare(estimate([o.psnr for o in runs]), estimate([o.psnr for o in plain]))
    word = {"worse": "better", "better": "worse"}.get(found.word, found.word)  # it says how `plain` compares
    return f"{found.difference:+.2f} ± {2 * found.standard_error:.2f}", word


def psnr_text(outcomes: list[Outcome]) -> str:
    """Mean ± std over seeds, or how many did not get to the end."""
    stopped = sum(math.isnan(o.psnr) for o in outcomes)
    if stopped:
        return f"{stopped} of {len(outcomes)} stopped by the guard"
    return measured(estimate([o.psnr for o in outcomes])).text


def page(of_norms: list[str], of_runs: list[str], helped: list[str], heading: str) -> str:
    said = (
        f"Clipping helps in: {', '.join(helped)}."
        if helped
        else "No case, healthy or hostile, shows a benefit beyond two standard errors: the pipeline clips nothing."
    )
    return "\n".join(
        [
            "### Gradient clipping",
            "",
            heading,
            "",
            said,
            "",
            "Why little is to be expected: the loss is L1 and SSIM, whose gradient by a pixel is bounded whatever the "
            "image holds, and Adam divides by the gradient's own size: however large, it moves a parameter by at most "
            "(1 − β₁)/√(1 − β₂) = 3.2 learning rates. What is not finite stops the run (pipeline/training/finite_checks.py).",
            "",
            f"Norms of the batch's gradient over the iterations of one run. Spike: the largest ratio to the median of "
            f"the {BEFORE} iterations before.",
            "",
            "| scene | field | median | 90 % / median | 99 % / median | largest / median | spike |",
            "|:---|:---|---:|---:|---:|---:|---:|",
            *of_norms,
            "",
            "PSNR on the test views after the last iteration, mean ± standard deviation over seeds; thresholds are "
            "quantiles of the norms of the healthy run (seed 0). Gain ± 2 standard errors.",
            "",
            "| case | clipped above | iterations clipped | PSNR, dB | gain, dB | verdict |",
            "|:---|:---|---:|---:|---:|:---|",
            *of_runs,
            "",
        ]
    )


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--iterations", type=int, default=1000, help="of train=fast (1000)")
    parser.add_argument("--points", type=int, default=8000, help="to start from (8000)")
    parser.add_argument("--size", type=int, default=200, help="width of the images, pixels (200)")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2], help="(0 1 2)")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "measured" / "clipping.md")
    options = parser.parse_args(arguments)
    if options.iterations <= 2 * BEFORE:
        parser.error(f"--iterations: expected more than {2 * BEFORE}, found {options.iterations}")
    torch.set_num_threads(1)
    configs = {
        scene: config_of(scene, options.iterations, options.points, options.size)
        for scene in dict.fromkeys(case.scene for case in CASES)
    }
    tables = study(configs, options.seeds, lambda line: print(line, flush=True))
    typed = sys.argv[1:] if arguments is None else arguments
    made = provenance(shlex.join(["python", "pipeline/studies/gradient_clipping.py", *typed]))
    heading = (
        f"`train=fast` from {options.points:,} points, {options.size} px, {options.iterations:,} iterations. "
        f"{made['machine']}; {made['date'][:16]}; commit {made['git_commit'][:10]}; `{made['command']}`."
    )
    write_text(options.out, page(*tables, heading))
    print(f"written to {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
