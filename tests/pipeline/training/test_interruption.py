"""A Ctrl-C that arrives while a tensor is converted for the kernel ends the training."""

from __future__ import annotations

import signal

import pytest
import torch
from tiny import tiny_config, train_tiny

from pipeline.stages.training_progress import TrainingProgress
from pipeline.terminal import interruption


def test_an_interrupt_during_a_conversion_is_not_lost(tmp_path, monkeypatch) -> None:
    convert, calls = torch.Tensor.__dlpack__, 0

    def interrupted(self, *args, **keys):
        nonlocal calls
        calls += 1
        if calls == 5:
            signal.raise_signal(signal.SIGINT)
        return convert(self, *args, **keys)

    monkeypatch.setattr(torch.Tensor, "__dlpack__", interrupted)
    monkeypatch.setattr(interruption, "_interrupted", False)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        interruption.watch()
        with pytest.raises(KeyboardInterrupt):
            train_tiny(tmp_path, tiny_config(10), observers=[TrainingProgress(10, None)])
    finally:
        signal.signal(signal.SIGINT, before)
    assert calls > 5  # it was lost once: conversions went on
