"""Ctrl-C ends the training wherever it arrives, and ends it as an interruption."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest
import torch
from tiny import tiny_config, train_tiny

from pipeline.stages.training_progress import TrainingProgress
from pipeline.terminal import interruption


@pytest.fixture
def watched(monkeypatch) -> Iterator[None]:
    monkeypatch.setattr(interruption, "_interrupted", False)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    interruption.watch()
    yield
    signal.signal(signal.SIGINT, before)


def test_an_interrupt_during_a_conversion_is_not_lost(watched, tmp_path, monkeypatch) -> None:
    convert, calls = torch.Tensor.__dlpack__, 0

    def interrupted(self, *args, **keys):
        nonlocal calls
        calls += 1
        if calls == 5:
            signal.raise_signal(signal.SIGINT)
        return convert(self, *args, **keys)

    monkeypatch.setattr(torch.Tensor, "__dlpack__", interrupted)
    with pytest.raises(KeyboardInterrupt):
        train_tiny(tmp_path, tiny_config(10), observers=[TrainingProgress(10, None)])
    assert calls > 5  # it was lost once: conversions went on


def test_an_error_in_tidying_up_after_an_interrupt_does_not_replace_it(watched) -> None:
    """As OmegaConf's does where it has built half a node."""
    with pytest.raises(ZeroDivisionError), interruption.not_replaced():
        1 / 0  # noqa: B018
    with pytest.raises(KeyboardInterrupt), interruption.not_replaced():
        try:
            signal.raise_signal(signal.SIGINT)
        finally:
            1 / 0  # noqa: B018
