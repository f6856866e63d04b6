"""Fused Adam against torch.optim.Adam in float64: all rows, and with rows skipped."""

from __future__ import annotations

import pytest
import torch
from builders import generator, off_centre_camera, output_weights, random_gaussians
from torch import Tensor

from rasterizer import Gaussians, Gradients, Rasterizer, Request
from rasterizer.adam import adam_step, sh_adam_step
from rasterizer.kernel_loader import kernel

STEPS = 6


def torch_adam(start: Tensor, gradients: list[Tensor], rates: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """(parameter, m, v) after steps of torch.optim.Adam in float64; `rates` broadcast against the parameter.

    Adam's step is proportional to its learning rate, so the step of rate 1 is scaled.
    """
    parameter = start.double()
    unit_rate = torch.zeros_like(parameter).requires_grad_()
    optimiser = torch.optim.Adam([unit_rate], lr=1.0, betas=(0.9, 0.999), eps=1e-15)
    for gradient in gradients:
        before = unit_rate.detach().clone()
        unit_rate.grad = gradient.double()
        optimiser.step()
        parameter = parameter + rates * (unit_rate.detach() - before)
    state = optimiser.state[unit_rate]
    return parameter, state["exp_avg"], state["exp_avg_sq"]


def random_steps(shape: tuple[int, ...], seed: int) -> tuple[Tensor, list[Tensor]]:
    rng = generator(seed)
    sizes = 10 ** (6 * torch.rand(shape, generator=rng) - 5)  # gradients from 1e-5 to 10
    return torch.randn(shape, generator=rng), [torch.randn(shape, generator=rng) * sizes for _ in range(STEPS)]


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize(
    ("shape", "rate"),
    [
        ((1003,), 0.05),
        ((257, 4), 1e-3),
        ((257, 4), [1e-3, 2e-3, 0.0, 0.05]),
        ((5, 3), [0.01, 0.02, 0.03]),
        ((0, 4), 0.1),
    ],
)
def test_parameters_and_moments_match_torch_adam(shape: tuple[int, ...], rate: float | list[float], threads: int):
    start, gradients = random_steps(shape, 1)
    parameter, m, v = start.clone(), torch.zeros(shape), torch.zeros(shape)
    for step, gradient in enumerate(gradients, start=1):
        adam_step(parameter, gradient, m, v, rate, step, threads=threads)
    expected = torch_adam(start, gradients, torch.tensor(rate, dtype=torch.float64))
    # Float32 rounds at 6e-8, several times per step: 1e-6 of the parameters (about 1), of the second moment (a sum of
    # squares), and of the gradients in the first moment, which may cancel.
    torch.testing.assert_close(parameter.double(), expected[0], rtol=0, atol=1e-6)
    assert ((m - expected[1]).abs() <= 1e-6 * torch.stack(gradients).abs().amax(0)).all()
    torch.testing.assert_close(v.double(), expected[2], rtol=1e-6, atol=0)


def test_a_zero_gradient_changes_neither_parameters_nor_moments():
    start, _ = random_steps((33, 4), 2)
    parameter, m, v = start.clone(), torch.zeros(33, 4), torch.zeros(33, 4)
    adam_step(parameter, torch.zeros(33, 4), m, v, 0.1, 1)
    assert torch.equal(parameter, start) and not m.any() and not v.any()


def test_skipped_rows_stay_and_the_others_equal_the_dense_step():
    shape = (101, 4)
    start, gradients = random_steps(shape, 3)
    dense = [start.clone(), torch.zeros(shape), torch.zeros(shape)]
    adam_step(dense[0], gradients[0], dense[1], dense[2], 0.01, 1)  # so that the moments are not zero
    sparse, before = [tensor.clone() for tensor in dense], [tensor.clone() for tensor in dense]
    mask = (torch.rand(101, generator=generator(4)) < 0.5).to(torch.uint8)
    adam_step(dense[0], gradients[1], dense[1], dense[2], 0.01, 2)
    adam_step(sparse[0], gradients[1], sparse[1], sparse[2], 0.01, 2, sparse_rows=mask)
    kept, skipped = mask.bool(), ~mask.bool()
    for found, stepped, untouched in zip(sparse, dense, before):
        assert torch.equal(found[skipped], untouched[skipped])
        assert torch.equal(found[kept], stepped[kept])
        assert not torch.equal(stepped[skipped], untouched[skipped])


def batch(gaussians: Gaussians, times: list[float], seed: int) -> Gradients:
    """Gradients of a batch of views at these times."""
    rasterizer, gradients = Rasterizer(threads=1), Gradients.zeros_like(gaussians)
    for number, time in enumerate(times):
        request = Request(off_centre_camera(), time=time)
        weights = output_weights(request, torch.ones(37, 45), generator(seed + number))
        rasterizer.render(gaussians, request)
        rasterizer.backward(gradients, d_color=weights["color"].to(torch.float32))
    return gradients


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize(("sh_degree", "fourier_order"), [(3, 2), (3, 0), (1, 1), (0, 2), (0, 0)])
def test_the_sh_step_matches_torch_adam_on_the_dense_gradient(sh_degree: int, fourier_order: int, threads: int):
    """One learning rate each for the constant coefficient, those of direction, of time, and of both."""
    gaussians = random_gaussians(83, "full", generator(5), sh_degree, fourier_order).to(torch.float32)
    batches = [batch(gaussians, [0.1, 0.5, 0.8], 10 * step) for step in range(3)]
    sh, m, v = gaussians.sh.clone(), torch.zeros_like(gaussians.sh), torch.zeros_like(gaussians.sh)
    for step, gradients in enumerate(batches, start=1):
        sh_adam_step(sh, gradients, m, v, (2.5e-3, 1.25e-4, 5e-4, 6e-5), step, threads=threads)
    rates = torch.full((1 + fourier_order, (1 + sh_degree) ** 2), 6e-5, dtype=torch.float64)
    rates[1:, 0], rates[0, 1:], rates[0, 0] = 5e-4, 1.25e-4, 2.5e-3
    rates = rates.reshape(-1, 1)
    dense = [gradients.sh() for gradients in batches]
    expected = torch_adam(gaussians.sh, dense, rates)
    # The gradient of a batch is a sum over views, whose rounding depends on their order: 1e-6 of the largest. Where it
    # cancels to about 0, Adam normalizes it, and the step is as uncertain as the gradient's sign.
    certain = torch.stack([g.abs() > 1e-4 * g.abs().max() for g in dense]).all(0) | torch.stack(
        [g == 0 for g in dense]
    ).all(0)
    assert certain.float().mean() > 0.8
    torch.testing.assert_close(sh.double()[certain], expected[0][certain], rtol=1e-5, atol=1e-6)
    for found, truth in zip((m, v), expected[1:]):
        torch.testing.assert_close(found.double(), truth, rtol=1e-4, atol=1e-6 * truth.abs().max().item())


@pytest.mark.parametrize("mask", ["visible", "random", "none"])
def test_skipped_sh_rows_stay_and_the_others_equal_the_dense_step(mask: str):
    """visible: Gaussians in some view of the batch (sparse Adam). random: any, as when Gaussians are frozen."""
    gaussians = random_gaussians(83, "full", generator(6)).to(torch.float32)
    gradients = batch(gaussians, [0.1, 0.15], 7)
    visible = torch.zeros(83, dtype=torch.bool)
    for view in gradients.views:
        visible[view.visible.long()] = True
    assert visible.any() and not visible.all()
    chosen = torch.rand(83, generator=generator(9)) < 0.5
    kept = {"visible": visible, "random": chosen, "none": torch.zeros_like(visible)}[mask]
    assert mask != "random" or ((visible & ~kept).any() and (~visible & kept).any())
    start = [gaussians.sh, torch.full_like(gaussians.sh, 0.1), torch.full_like(gaussians.sh, 0.2)]
    dense, sparse = [tensor.clone() for tensor in start], [tensor.clone() for tensor in start]
    sh_adam_step(dense[0], gradients, dense[1], dense[2], [0.01, 0.002, 0.005, 0.001], 5)
    sh_adam_step(
        sparse[0], gradients, sparse[1], sparse[2], [0.01, 0.002, 0.005, 0.001], 5, sparse_rows=kept.to(torch.uint8)
    )
    for found, stepped, untouched in zip(sparse, dense, start):
        assert torch.equal(found[~kept], untouched[~kept])
        assert torch.equal(found[kept], stepped[kept])
        assert not torch.equal(stepped[~kept], untouched[~kept])


def test_sh_degrees_and_fourier_orders_that_no_view_used_are_skipped():
    gaussians = random_gaussians(83, "full", generator(8)).to(torch.float32)
    rasterizer, gradients = Rasterizer(threads=1), Gradients.zeros_like(gaussians)
    request = Request(off_centre_camera(), time=0.5, sh_degree=1, fourier_order=1)
    rasterizer.render(gaussians, request)
    rasterizer.backward(gradients, d_color=torch.ones(3, 37, 45))
    sh, m, v = gaussians.sh.clone(), torch.zeros_like(gaussians.sh), torch.zeros_like(gaussians.sh)
    sh_adam_step(sh, gradients, m, v, [0.01] * 4, 1)
    used = torch.zeros(48, dtype=torch.bool)
    used[[0, 1, 2, 3, 16, 17, 18, 19]] = True  # degrees 0 and 1 of Fourier orders 0 and 1
    visible = gradients.views[0].visible.long()
    assert torch.equal(sh[:, ~used], gaussians.sh[:, ~used]) and not m[:, ~used].any() and not v[:, ~used].any()
    torch.testing.assert_close(m[:, used], 0.1 * gradients.sh()[:, used])  # the first step: (1 - β1) g
    assert (m[visible][:, used] != 0).float().mean() > 0.5


@pytest.mark.parametrize("threads", [1, 2])
def test_denormal_moments_are_flushed_to_zero_inside_adam_only(threads: int):
    """m of an invisible Gaussian shrinks by β1 per step; as a denormal it would stay and slow down every later step."""
    parameter, m, v = torch.ones(40, 4), torch.full((40, 4), 1e-39), torch.full((40, 4), 1e-12)
    adam_step(parameter, torch.zeros(40, 4), m, v, 0.01, 1000, threads=threads)
    assert not m.any() and torch.equal(parameter, torch.ones(40, 4))
    gaussians = random_gaussians(40, "full", generator(1)).to(torch.float32)
    sh, m, v = gaussians.sh.clone(), torch.full_like(gaussians.sh, 1e-39), torch.full_like(gaussians.sh, 1e-12)
    sh_adam_step(sh, batch(gaussians, [], 0), m, v, [0.01] * 4, 1000, threads=threads)
    assert not m[:, 0].any() and torch.equal(sh, gaussians.sh)
    assert (torch.full((5,), 1e-39) * 0.5).all()  # the processor's flush-to-zero mode is restored


@pytest.mark.parametrize("name", ["param", "m", "v"])
@pytest.mark.parametrize("wrong", [torch.zeros(4, 5).T, torch.zeros(5, 4, dtype=torch.float64)])
def test_a_tensor_that_the_kernel_cannot_write_is_refused(name: str, wrong: Tensor) -> None:
    """nanobind would pass a copy, and the step would be lost."""
    tensors = {key: torch.zeros(5, 4) for key in ("param", "m", "v")} | {name: wrong}
    with pytest.raises(ValueError, match=f"{name} must be contiguous float32 .5, 4., got"):
        adam_step(tensors["param"], torch.ones(5, 4), tensors["m"], tensors["v"], 0.1, 1)


def test_tensors_of_other_shapes_are_refused() -> None:
    """The kernel takes its size from the parameter alone."""
    zeros = torch.zeros
    for grad, m, v, rows, step, message in (
        (zeros(1), zeros(5, 4), zeros(5, 4), None, 1, "grad must be contiguous float32 .5, 4., got .* .1."),
        (zeros(5, 4), zeros(5), zeros(5, 4), None, 1, "m must be contiguous float32 .5, 4., got .* .5."),
        (zeros(5, 4), zeros(5, 4), zeros(6, 4), None, 1, "v must be contiguous float32 .5, 4., got .* .6, 4."),
        (
            zeros(5, 4),
            zeros(5, 4),
            zeros(5, 4),
            zeros(4, dtype=torch.uint8),
            1,
            "sparse_rows must be contiguous uint8 .5., got",
        ),
        (zeros(5, 4), zeros(5, 4), zeros(5, 4), None, 0, "step must be an integer of at least 1, got 0"),
        (zeros(5, 4), zeros(5, 4), zeros(5, 4), None, 1.5, "step must be an integer of at least 1, got 1.5"),
    ):
        with pytest.raises(ValueError, match=message):
            adam_step(zeros(5, 4), grad, m, v, 0.1, step, sparse_rows=rows)
    with pytest.raises(ValueError, match=r"sh must be \(N, K, 3\) with K among .*, got \[5, 5, 3\]"):
        gradients = Gradients.zeros_like(random_gaussians(5, "full", generator(1)).to(torch.float32))
        sh_adam_step(zeros(5, 5, 3), gradients, zeros(5, 5, 3), zeros(5, 5, 3), [0.1] * 4, 1)


def test_the_kernel_refuses_to_write_a_copy() -> None:
    with pytest.raises(TypeError):
        kernel.set_to_zero(arrays=[torch.ones(4, 5).T], threads=1)
