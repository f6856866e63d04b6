"""What replaces the kernel's functions on a device: against them, on a device that tests pretend."""

from __future__ import annotations

import subprocess
import sys

import pytest
import torch
from builders import generator, off_centre_camera, output_weights, random_gaussians
from pretended_device import pretended_device

from rasterizer import Gradients, Rasterizer, Request, ViewGradient
from rasterizer.adam import adam_step, sh_adam_step
from rasterizer.gradients import ViewColors
from rasterizer.gsplat_rasterizer import NoGpu, gpu
from rasterizer.loss import PhotometricLoss

SH_RATES = (2.5e-3, 1.25e-4, 5e-4, 6e-5)


def a_batch(sh_degree: int, fourier_order: int) -> tuple[Gradients, ViewGradient]:
    """Gradients of two views, the first of lower degree and order; the second's statistics."""
    gaussians = random_gaussians(83, "full", generator(5), 3, 2).to(torch.float32)
    rasterizer, gradients = Rasterizer(threads=1), Gradients.zeros_like(gaussians)
    for number, limits in enumerate([(min(sh_degree, 1), 0), (sh_degree, fourier_order)]):
        request = Request(off_centre_camera(), 0.2 + 0.4 * number, sh_degree=limits[0], fourier_order=limits[1])
        rasterizer.render(gaussians, request)
        weights = output_weights(request, torch.ones(37, 45), generator(number))
        view = rasterizer.backward(gradients, d_color=weights["color"].float())
    return gradients, view


def moved(gradients: Gradients, device: torch.device) -> Gradients:
    views = [
        ViewColors(v.visible.to(device), v.gradient.to(device), v.sh_degree, v.fourier_order) for v in gradients.views
    ]
    dense = {name: tensor.to(device) for name, tensor in gradients.dense().items()}
    return Gradients(**dense, sh_shape=gradients.sh_shape, views=views)


@pytest.mark.parametrize(("sh_degree", "fourier_order"), [(3, 2), (3, 0), (1, 1), (0, 2), (0, 0)])
def test_the_gradient_of_4dsh(sh_degree: int, fourier_order: int):
    gradients, _ = a_batch(sh_degree, fourier_order)
    expected = gradients.sh()
    with pretended_device() as device:
        found = moved(gradients, device).sh().cpu()
    assert expected.any()
    # Two products and a sum over two views in float32.
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-6 * expected.abs().max().item())


@pytest.mark.parametrize("sparse", [False, True])
@pytest.mark.parametrize("rate", [0.05, [1e-3, 2e-3, 0.0, 0.05]])
def test_adam(rate: float | list[float], sparse: bool):
    """Against the kernel's, over three steps. A step is about the rate; float32 rounds the parameters at 6e-8."""
    rng = generator(1)
    tensors = [torch.randn(257, 4, generator=rng), torch.zeros(257, 4), torch.zeros(257, 4)]
    rows = (torch.rand(257, generator=rng) < 0.5).to(torch.uint8) if sparse else None
    with pretended_device() as device:
        there = [tensor.to(device) for tensor in tensors]
    for step in range(1, 4):
        gradient = torch.randn(257, 4, generator=rng)
        adam_step(tensors[0], gradient, *tensors[1:], rate, step, rows)
        with pretended_device() as device:
            adam_step(there[0], gradient.to(device), *there[1:], rate, step, None if rows is None else rows.to(device))
    with pretended_device():
        for found, expected in zip(there, tensors):
            torch.testing.assert_close(found.cpu(), expected, rtol=2e-6, atol=1e-6)


@pytest.mark.parametrize("sparse", [False, True])
def test_adam_of_4dsh(sparse: bool):
    gradients, view = a_batch(3, 2)
    rows = None
    if sparse:
        rows = torch.zeros(83, dtype=torch.uint8)
        view.mark_visible(rows)
    sh, m, v = torch.randn(83, 48, 3, generator=generator(2)), torch.zeros(83, 48, 3), torch.zeros(83, 48, 3)
    with pretended_device() as device:
        there = [tensor.to(device) for tensor in (sh, m, v)]
        sh_adam_step(
            there[0], moved(gradients, device), *there[1:], SH_RATES, 1, None if rows is None else rows.to(device)
        )
        found = [tensor.cpu() for tensor in there]
    sh_adam_step(sh, gradients, m, v, SH_RATES, 1, rows)
    largest = m.abs().max()
    for one, expected in zip(found[1:], (m, v)):
        torch.testing.assert_close(one, expected, rtol=1e-4, atol=1e-6 * expected.abs().max().item())
    # The first step of Adam is the gradient's sign, which rounding decides where the gradient cancels.
    certain = (m.abs() > 1e-4 * largest) | (m == 0)
    assert certain.float().mean() > 0.8
    torch.testing.assert_close(found[0][certain], sh[certain], rtol=0, atol=1e-6)


def test_densification_statistics():
    _, view = a_batch(3, 2)
    here = [torch.rand(83, generator=generator(3)) for _ in range(3)]
    mark = torch.zeros(83, dtype=torch.uint8)
    with pretended_device() as device:
        there, there_mark = [tensor.to(device) for tensor in here], mark.to(device)
        on_device = ViewGradient(**{name: tensor.to(device) for name, tensor in vars(view).items()})
        on_device.accumulate(*there, off_centre_camera(), 0.8)
        on_device.mark_visible(there_mark)
        found, found_mark = [tensor.cpu() for tensor in there], there_mark.cpu()
    view.accumulate(*here, off_centre_camera(), 0.8)
    view.mark_visible(mark)
    assert torch.equal(found_mark, mark) and 0 < mark.sum() < 83
    for one, expected in zip(found, here):
        torch.testing.assert_close(one, expected, rtol=1e-6, atol=0)


@pytest.mark.parametrize("size", [(37, 53), (11, 11), (3, 40)])
def test_the_photometric_loss(size: tuple[int, int]):
    rng = generator(4)
    target = torch.rand(3, *size, generator=rng)
    image = target + 0.1 * torch.randn(3, *size, generator=rng)
    expected = PhotometricLoss(mse_weight=5.0)(image, target, share=0.5)
    with pretended_device() as device:
        found = PhotometricLoss(mse_weight=5.0)(image.to(device), target.to(device), share=0.5)
        gradient = found.d_image.cpu()
    for name in ("loss", "l1", "ssim", "mse"):  # the kernel's tests say why
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=4e-5, abs=2e-6)
    assert (gradient - expected.d_image).abs().max() <= 4e-4 * expected.d_image.abs().max()


def test_gradients_are_reset_and_found_not_finite():
    gradients, _ = a_batch(3, 2)
    with pretended_device() as device:
        there = moved(gradients, device)
        assert there.all_finite()
        there.views[0].gradient[3, 1] = torch.nan
        assert not there.all_finite()
        there.zero_()
        assert there.all_finite() and not there.views and not there.log_scale.cpu().any()


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_without_a_gpu_a_line_says_what_to_install():
    with pytest.raises(
        NoGpu, match=r"backend=gsplat: expected .*, found .*; `make gpu` installs .*backend=cpu"
    ) as error:
        gpu()
    assert "\n" not in str(error.value)


def test_nothing_imports_gsplat():
    """Neither the rasterizer nor its GPU's part, before a view is rendered."""
    program = "import sys, rasterizer.gsplat_rasterizer; sys.exit('gsplat' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program]).returncode == 0
