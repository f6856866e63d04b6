"""`train.released_gradients`: it reaches the training, and with `untrained` that is the training without 4DSH."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from tiny import tiny_config, train_tiny

from pipeline.config.schema import AblationConfig
from pipeline.config.train_schema import TrainConfig
from pipeline.model.model import Model
from rasterizer.request import RELEASED_GRADIENTS


def trained(path: Path, *released: str, ablation: AblationConfig | None = None, iterations: int = 60) -> Model:
    orders = [5, 6, 7, 2, 3]  # of SH and Fourier, early
    cfg = tiny_config(iterations, released_gradients=list(released), orders_at=orders)
    return train_tiny(path, replace(cfg, ablation=ablation or cfg.ablation)).model


def test_untrained_is_the_training_without_4dsh(tmp_path: Path):
    """Code compiled for fewer Fourier orders rounds otherwise: the same but for float32 rounding, which 20 steps of
    Adam carry to 1e-5. Exact gradients change the coefficients by a hundred times that."""
    untrained = trained(tmp_path / "a", "untrained", iterations=20).parameters
    without = trained(tmp_path / "b", iterations=20, ablation=AblationConfig(fourier_order=0)).parameters
    constant = without["sh"].shape[1]
    assert not untrained["sh"][:, constant:].any()
    untrained["sh"] = untrained["sh"][:, :constant]
    for name, parameter in without.items():
        torch.testing.assert_close(untrained[name], parameter, rtol=1e-5, atol=1e-5)
    assert trained(tmp_path / "c", iterations=20).parameters["sh"][:, constant:].abs().max() > 1e-3


@pytest.mark.parametrize("name", RELEASED_GRADIENTS)
def test_each_changes_what_is_trained(tmp_path: Path, name: str):
    exact, released = trained(tmp_path / "a"), trained(tmp_path / "b", name)
    assert not torch.equal(exact.parameters["sh"], released.parameters["sh"])


def test_the_schema_has_the_kernels_names():
    TrainConfig(released_gradients=list(RELEASED_GRADIENTS))
    with pytest.raises(ValueError, match=f"train.released_gradients.*some of {', '.join(RELEASED_GRADIENTS)}"):
        TrainConfig(released_gradients=["fixed"])
