"""The benchmark's command line, its workloads and its baselines; speed itself is not tested."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
import torch

from rasterizer import Rasterizer
from rasterizer.bench.baselines import torch_loss
from rasterizer.bench.frame_time import count_work
from rasterizer.bench.scaling import Growth, strip_seconds, waiting_share
from rasterizer.bench.workloads import SplitMix64, Workload, make_workload
from rasterizer.kernel_loader import available_isas, load_kernel
from rasterizer.loss import PhotometricLoss
from rasterizer.reference import render as reference
from rasterizer.reference.blend import blending_weights, pixel_centers, splat_alpha


def naive_splitmix64(seed: int, count: int) -> list[float]:
    """The published recurrence in Python's integers, one draw at a time."""
    mask, out = (1 << 64) - 1, []
    for _ in range(count):
        seed = (seed + 0x9E3779B97F4A7C15) & mask
        z = seed
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
        out.append(((z ^ (z >> 31)) >> 40) / 2**24)
    return out


def test_vectorized_draws_equal_the_recurrence_across_calls() -> None:
    generator = SplitMix64(1234567)
    ours = np.concatenate([generator.uniform(3, 4).ravel(), generator.uniform(1, 5).ravel()])
    assert ours.tolist() == naive_splitmix64(1234567, 17)  # 24 bits each: exact in float32


@pytest.fixture(scope="module")
def w1() -> Workload:
    return make_workload("W1")


@pytest.mark.parametrize("isa", available_isas())
def test_every_instruction_set_sees_the_same_gaussians(w1: Workload, isa: str) -> None:
    rasterizer = Rasterizer(1, load_kernel(isa))
    rasterizer.render(w1.gaussians, w1.request())
    assert rasterizer.visible == 63_657  # the scene is the same on every machine


def test_json_output_and_the_isa_option() -> None:
    isa = available_isas()[-1]
    options = ["--isa", isa, "--repeats", "1", "--threads", "1", "--json"]
    command = [sys.executable, "-m", "rasterizer.bench", "W1", *options]
    found = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert found["isa"] == isa
    w1 = found["workloads"]["W1"]
    assert w1["counts"]["visible"] == 63_657
    one = w1["threads"]["1"]
    assert one["total"]["median"] >= one["total"]["minimum"] >= one["forward"]["minimum"] > 0
    assert (found["workload"], found["threads"]) == ("W1", 1)  # the flat summary of a single workload
    for part in ("forward", "backward", "total"):
        assert found[f"{part}_ms"] == one[part]["minimum"]
    assert found["stages"] == {stage: ms["minimum"] for stage, ms in one["stages"].items()}
    assert w1["bound_ms"] > 0 and found["rates"]["operations"] > 0 and set(one["stages"]) >= {"preprocess", "blend"}


def test_contributing_pairs_equal_the_count_of_the_reference(w1: Workload) -> None:
    crop = w1.cropped(16)  # one tile
    splats = reference.make_splats(crop.gaussians, crop.request())
    weight, _ = blending_weights(splat_alpha(splats, pixel_centers(crop.camera, torch.float32).reshape(-1, 2)))
    found = count_work(crop)
    # A pair within float32's rounding of a threshold may fall on either side.
    assert found.contributing == pytest.approx(int((weight > 0).sum()), rel=1e-3)
    assert found.pairs % 16 == 0 and found.pairs >= found.contributing


def test_a_crop_shifts_the_principal_point(w1: Workload) -> None:
    points = torch.tensor([[0.0, 0.0, 4.0], [0.1, -0.2, 3.0]], dtype=torch.float64)
    whole = reference.project_point(points, w1.camera)
    part = reference.project_point(points, w1.cropped(24).camera)
    assert (whole - part == 188).all()  # (400 - 24) / 2, exact in binary


def test_the_torch_baseline_computes_the_same_loss_and_gradient() -> None:
    generator = torch.Generator().manual_seed(3)
    image, target = (torch.rand(3, 40, 40, generator=generator) for _ in range(2))
    leaf = image.clone().requires_grad_()
    expected = torch_loss(leaf, target)
    (gradient,) = torch.autograd.grad(expected, leaf)
    ours = PhotometricLoss(threads=1)(image, target)
    assert ours.loss == pytest.approx(expected.item(), abs=1e-5)  # float32 sums over 4800 values
    assert (ours.d_image - gradient).abs().max() < 1e-4 * gradient.abs().max()


@pytest.mark.parametrize(
    "seconds, threads, share",
    [
        ([1.0, 1.0, 1.0, 1.0], 2, 0.0),
        ([2.0, 1.0, 1.0], 2, 0.0),
        ([1.0, 3.0], 2, 1 - 4 / 6),  # one second beside three
        ([1.0, 1.0, 2.0], 2, 1 - 4 / 6),  # the last one begins after a second
        ([5.0], 4, 0.75),
    ],
)
def test_threads_wait_for_the_last(seconds: list[float], threads: int, share: float) -> None:
    assert waiting_share(seconds, threads) == pytest.approx(share, abs=1e-12)


def test_exponents_are_those_of_powers() -> None:
    assert Growth("x", (10, 20, 80), (3.0, 6.0, 24.0)).exponents == pytest.approx((1.0, 1.0))
    assert Growth("x", (10, 20, 80), (3.0, 3.0, 48.0)).exponents == pytest.approx((0.0, 2.0))


def test_strips_are_all_tiles_of_the_image(w1: Workload) -> None:
    small = w1.cropped(40)  # 3 × 3 tiles
    assert [len(strip_seconds(small, tiles, 1)) for tiles in (1, 2, 3, 8)] == [9, 6, 3, 3]
