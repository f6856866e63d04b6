"""This machine reaches the stored PSNR of a short training after 25, 50, 75 and 100 iterations.

The stored runs differ in instruction sets, of the kernel and of PyTorch; the tolerance is four of their standard
deviations, 0.002 dB at least (pipeline/studies/reference_points/README.md). Faults of the kinds that a change could
bring are beyond it.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import pipeline.training.loop as loop
from pipeline.config.compose import Command
from pipeline.stages.run import run
from pipeline.studies.reference_points.points import (
    AT,
    COMMAND,
    DEVIATIONS,
    FLOOR,
    SEEDS,
    beyond,
    curve,
    points,
    stored,
    table,
)  # fmt: skip
from pipeline.training.state import TrainState

AGAIN = "python -m pipeline.studies.reference_points"  # where a recipe is meant to have changed


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., np.ndarray]:
    """The curve of a seed, with overrides."""
    folder = tmp_path_factory.mktemp("points")

    def get(seed: int, *overrides: str) -> np.ndarray:
        out = folder / "run"
        keys = (f"scene.cache={folder}", f"out={out}", "threads=1", "resume=false", f"seed={seed}")
        run(Command((*COMMAND, *keys, *overrides)), lambda line: None)
        return curve(out)

    return get


@pytest.mark.parametrize("seed", [0, 1])
def test_a_seed_reaches_its_reference_points(trained: Callable[..., np.ndarray], seed: int) -> None:
    assert beyond(trained(seed), seed, points(stored())) == [], AGAIN


def test_a_wrong_learning_rate_does_not(trained: Callable[..., np.ndarray]) -> None:
    """By 2 %."""
    found = beyond(trained(0, "train.lr.factor=2.04"), 0, points(stored()))
    assert found and found[0].startswith("iteration 25: "), found


@pytest.mark.parametrize(
    "name, rows", [("log_scale", slice(None)), ("opacity_logit", slice(None)), ("mean", slice(100))]
)
def test_a_dropped_gradient_does_not(
    trained: Callable[..., np.ndarray], monkeypatch: pytest.MonkeyPatch, name: str, rows: slice
) -> None:
    """Of a parameter, or of the positions of 5 % of the Gaussians."""
    step = loop.optimiser_step

    def without(state: TrainState, *others: object) -> None:
        getattr(state.gradients, name)[rows] = 0
        step(state, *others)

    monkeypatch.setattr(loop, "optimiser_step", without)
    found = beyond(trained(0), 0, points(stored()))
    assert found and found[0].startswith("iteration 25: "), found


def test_points_of_known_curves() -> None:
    curves = {("v3/avx2", 0): [20, 21, 22, 23], ("v3/avx2", 1): [22, 23, 24, 25],
              ("v4/avx2", 0): [20, 21, 22.3, 23], ("v4/avx2", 1): [22, 23, 24.4, 25],
              ("v4/default", 0): [20, 21, 22.1, 23], ("v4/default", 1): [22, 23, 24.4, 25]}  # fmt: skip
    known = points({key: np.array(values, dtype=float) for key, values in curves.items()})
    first, _, third, _ = known
    assert first.by_seed == {0: 20, 1: 22} and first.mean == 21 and first.tolerance == FLOOR
    assert first.between_seeds == pytest.approx(np.sqrt(2)) and first.between_kernels == 0
    variance = (2 * 0.1**2 + 2 * 0.2**2) / 2  # of each seed's two values, n - 1, mean of both
    assert third.tolerance == pytest.approx(DEVIATIONS * np.sqrt(variance))
    found = beyond(np.array([20.0019, 21, 22.1, np.nan]), 0, known)
    assert found == ["iteration 100: nan dB, expected 23.0000 ± 0.0020"]
    with pytest.raises(ValueError, match="found none of v4/default, seed 1"):
        points({key: np.array(values) for key, values in list(curves.items())[:5]})


def test_stored_curves_are_of_all_seeds_and_instruction_sets(tmp_path: Path) -> None:
    found = stored()
    roundings = {name for name, _ in found}
    assert len(found) == SEEDS * len(roundings) and {name.split("/")[0] for name in roundings} >= {"v2", "v3", "v4"}
    header, rows = table(found)
    (tmp_path / "again.csv").write_text("\n".join(",".join(map(str, row)) for row in [header, *rows]) + "\n")
    again = stored(tmp_path / "again.csv")
    assert all(np.array_equal(again[key], found[key]) for key in found) and len(found[next(iter(found))]) == len(AT)
