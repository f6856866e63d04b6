"""Reference points: the test PSNR that a short training reaches after so many iterations, and how far programs that
only round differently are apart."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

AT = (25, 50, 75, 100)  # iterations
SEEDS = 10
COMMAND = (
    "scene=synthetic/wheel",
    "scene.size=48",
    "scene.train_views=16",
    "scene.test_views=4",
    "train=short",
    "train.init_points=2000",
    f"train.iterations={AT[-1]}",
    f"train.eval_every={AT[0]}",
    "until=train",
)
STORED = Path(__file__).with_name("results.csv")
DEVIATIONS = 4.0
FLOOR = 0.002  # dB, for what was not measured: another processor and another compiler round differently, too


@dataclass(frozen=True)
class Rounding:
    """What decides how a run rounds on one machine."""

    kernel: str  # its instruction set, RASTERIZER_ISA
    torch: str  # PyTorch's, ATEN_CPU_CAPABILITY

    def __str__(self) -> str:
        return f"{self.kernel}/{self.torch}"


Curves = Mapping[tuple[str, int], np.ndarray]  # (rounding, seed) -> PSNR at AT, dB


@dataclass(frozen=True)
class Point:
    """At one iteration. Standard deviations in dB."""

    iteration: int
    by_seed: dict[int, float]  # seed -> PSNR, mean over the kernels
    between_seeds: float  # of `by_seed`
    between_kernels: float  # of one seed, pooled over the seeds

    @property
    def mean(self) -> float:
        return float(np.mean(list(self.by_seed.values())))

    @property
    def tolerance(self) -> float:
        """Within which a run of a seed is on any machine, dB."""
        return max(FLOOR, DEVIATIONS * self.between_kernels)


def points(curves: Curves) -> list[Point]:
    """Of the kernels' instruction sets, each the mean over PyTorch's. ValueError where a seed was not run with all."""
    roundings, seeds = sorted({key for key, _ in curves}), sorted({seed for _, seed in curves})
    if missing := [f"{key}, seed {seed}" for key in roundings for seed in seeds if (key, seed) not in curves]:
        raise ValueError(f"reference points: expected each seed with each rounding, found none of {missing[0]}")
    kernels: dict[str, list[str]] = {}
    for key in roundings:
        kernels.setdefault(key.partition("/")[0], []).append(key)
    values = np.array([[np.mean([curves[k, s] for k in keys], 0) for s in seeds] for keys in kernels.values()])
    means = values.mean(0)  # of (kernels, seeds, AT)
    spread = np.sqrt(values.var(0, ddof=1).mean(0)) if len(kernels) > 1 else np.full(len(AT), math.nan)
    return [
        Point(iteration, dict(zip(seeds, means[:, i].tolist())), float(means[:, i].std(ddof=1)), float(spread[i]))
        for i, iteration in enumerate(AT)
    ]


def curve(run: Path) -> np.ndarray:
    """Test PSNR at AT of a run folder, dB."""
    rows = _rows(run / "error_vs_time.csv")
    found = {int(row["iteration"]): float(row["psnr"]) for row in rows}
    return np.array([found[iteration] for iteration in AT])


def stored(path: Path = STORED) -> dict[tuple[str, int], np.ndarray]:
    columns = [f"psnr_{iteration}" for iteration in AT]
    return {
        (row["rounding"], int(row["seed"])): np.array([float(row[column]) for column in columns]) for row in _rows(path)
    }


def table(curves: Curves) -> tuple[list[str], list[list]]:
    """Header and rows of the CSV that `stored` reads."""
    rows = [[rounding, seed, *(f"{value:.6f}" for value in values)] for (rounding, seed), values in curves.items()]
    return ["rounding", "seed", *(f"psnr_{iteration}" for iteration in AT)], rows


def beyond(found: np.ndarray, seed: int, known: Iterable[Point]) -> list[str]:
    """Where a seed's PSNR at AT is outside of the tolerance, in words."""
    return [
        f"iteration {point.iteration}: {value:.4f} dB, expected {point.by_seed[seed]:.4f} ± {point.tolerance:.4f}"
        for value, point in zip(found, known)
        if not abs(value - point.by_seed[seed]) <= point.tolerance
    ]


def _rows(path: Path) -> list[dict[str, str]]:
    with open(path, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))
