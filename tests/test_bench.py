"""The benchmark's command line and its workloads. How fast anything is, is no test."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

from rasterizer.bench import SplitMix64, make_workload
from rasterizer.kernel import available_isas


def naive_splitmix64(seed: int, count: int) -> list[float]:
    """The published recurrence, one draw after another, in Python's integers."""
    mask, out = (1 << 64) - 1, []
    for _ in range(count):
        seed = (seed + 0x9E3779B97F4A7C15) & mask
        z = seed
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
        out.append(((z ^ (z >> 31)) >> 40) / 2**24)
    return out


def test_draws_are_splitmix64s_also_from_call_to_call() -> None:
    generator = SplitMix64(1234567)
    ours = np.concatenate([generator.uniform(3, 4).ravel(), generator.uniform(1, 5).ravel()])
    assert ours.tolist() == naive_splitmix64(1234567, 17)  # 24 bits each: exact in float32


@pytest.mark.parametrize("isa", available_isas())
def test_the_command_measures_the_instruction_set_it_was_told(isa: str) -> None:
    command = [sys.executable, "-m", "rasterizer.bench", "W1", "--isa", isa, "--repeats", "1", "--json"]
    found = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert (found["workload"], found["isa"], found["threads"]) == ("W1", isa, 1)
    assert found["visible"] == 63_657  # as the notes on performance say of W1: the same scene for everybody
    assert found["total_ms"] >= found["forward_ms"] > 0 and set(found["stages"]) >= {"prepare", "blend"}


def test_w2_is_larger_and_w2h_is_w2_at_half_size() -> None:
    full, half = make_workload("W2"), make_workload("W2h")
    assert len(full.gaussians) == len(half.gaussians) == 300_000
    assert (full.camera.width, half.camera.width) == (1352, 676)
    assert all((a == b).all() for a, b in zip(full.gaussians.tensors().values(), half.gaussians.tensors().values()))
