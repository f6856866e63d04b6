"""The order of the Gaussians in memory."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tiny import TinyRun, random_model, tiny_config, train_tiny

from pipeline.model.model import ModelKind
from pipeline.training.density import row_order
from pipeline.training.density.row_order import BITS, TIMES, memory_order
from pipeline.training.density.statistics import Statistics
from pipeline.training.optimiser import Adam


def naive_key(mean: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[int, str]:
    """(part of the time, Morton code as text), from the digits of the coordinates' binary numbers."""
    share = (mean - low) / (high - low)
    digits = [f"{min(int(x * 2**BITS), 2**BITS - 1):0{BITS}b}" for x in share[:3]]
    code = "".join(z + y + x for x, y, z in zip(*digits, strict=True))
    return min(int(share[3] * TIMES), TIMES - 1), code


def test_rows_are_sorted_by_time_and_along_a_morton_curve() -> None:
    model = random_model(ModelKind("full", 1, 1), 300)
    mean = model.parameters["mean"].numpy().astype(np.float64)
    keys = [naive_key(row, mean.min(axis=0), mean.max(axis=0)) for row in mean]
    expected = sorted(range(300), key=keys.__getitem__)  # stable, too
    assert memory_order(model).tolist() == expected


def test_equal_places_keep_their_order_and_static_models_have_no_time() -> None:
    model = random_model(ModelKind("static", 0, 1), 50)
    model.parameters["mean"][:] = 1.0
    assert memory_order(model).tolist() == list(range(50))


def test_moments_and_sphere_move_with_their_gaussians() -> None:
    model = random_model(ModelKind("full", 1, 1), 30)
    model.sphere = torch.arange(30) % 3 == 0
    adam = Adam(model)
    adam.first["mean"], before = model.parameters["mean"].clone(), model.parameters["opacity_logit"].clone()
    order = memory_order(model)
    adam.keep(order)
    assert torch.equal(adam.first["mean"], model.parameters["mean"])
    assert torch.equal(model.parameters["opacity_logit"], before[order])
    assert torch.equal(model.sphere, order % 3 == 0)


def test_statistics_of_densification_move_with_their_gaussians() -> None:
    statistics = Statistics(5)
    for value, name in enumerate(Statistics.FIELDS):
        getattr(statistics, name)[:] = 10.0 * value + torch.arange(5)
    statistics.reorder(torch.tensor([3, 0, 4, 1, 2]))
    for value, name in enumerate(Statistics.FIELDS):
        assert (getattr(statistics, name) - 10 * value).tolist() == [3, 0, 4, 1, 2]


def test_training_sorts_with_the_same_bits_for_any_number_of_threads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    unsorted = train_tiny(tmp_path / "unsorted", tiny_config()).model
    monkeypatch.setattr(row_order, "FEWEST", 1)
    monkeypatch.setattr(row_order, "EVERY", 20)
    one, three = (
        train_tiny(tmp_path / str(threads), replace(tiny_config(), threads=threads)).model for threads in (1, 3)
    )
    events = [row for row in TinyRun(tmp_path / "1").rows("log.jsonl") if row["event"] == row_order.RowOrder.event]
    assert [row["iteration"] for row in events] == [20, 40] and all(row["sorted"] > 0 for row in events)
    assert all(torch.equal(p, three.parameters[name]) for name, p in one.parameters.items())
    assert len(one) != len(unsorted) or not torch.equal(one.parameters["mean"], unsorted.parameters["mean"])
