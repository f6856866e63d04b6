"""gsplat as the rasterizer, on the CPU by its PyTorch twins: against the float64 reference and the kernel.

What the conventions of both render alike agrees to rounding; what they do not is bounded, and listed in docs/gpu.md.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch
from gsplat_parity import (
    DIFFERENT,
    SAME,
    Scene,
    by_engine,
    by_reference,
    gradient_error,
    image_error,
    of_kind,
    seen_by_one,
    statistics_error,
)
from gsplat_twins import gsplat_on_the_cpu
from pretended_device import pretended_device

from rasterizer import Gradients, Rasterizer
from rasterizer.gsplat_rasterizer import GsplatRasterizer

pytest.importorskip("gsplat", reason="the extra `gpu` is not installed")
CPU = torch.device("cpu")
# Of the largest value: float64 has 1e-16, and sums over up to 150 Gaussians. Of float32, as the kernel's tests.
EXACT, IMAGE_TOLERANCE, GRADIENT_TOLERANCE = 1e-12, 3e-5, 1e-4


@pytest.fixture(autouse=True)
def on_the_cpu() -> Iterator[None]:
    with gsplat_on_the_cpu():
        yield


@pytest.fixture(params=SAME)
def scene(request: pytest.FixtureRequest) -> Scene:
    return SAME[request.param]()


def test_images_and_gradients_are_the_reference_s_in_float64(scene: Scene):
    truth, weights = by_reference(scene)
    found = by_engine(GsplatRasterizer(CPU), scene, weights, torch.float64)
    assert image_error(found, truth, scene) < EXACT
    assert gradient_error(found, truth) < EXACT


def test_on_a_device_in_float32_with_the_kernel_s_statistics(scene: Scene):
    truth, weights = by_reference(scene)
    kernel = by_engine(Rasterizer(1), scene, weights, torch.float32)
    with pretended_device() as device:
        found = by_engine(GsplatRasterizer(device), scene, weights, torch.float32)
    assert image_error(found, truth, scene) < IMAGE_TOLERANCE
    assert gradient_error(found, truth) < GRADIENT_TOLERANCE
    assert statistics_error(found, kernel) < GRADIENT_TOLERANCE
    assert found.alive == kernel.alive
    only_kernel, only_gsplat = seen_by_one(found, kernel)
    assert not only_kernel
    # gsplat also counts what has its box in the image and no pixel: statistics of zero.
    assert found.view is not None
    rows = [row in only_gsplat for row in found.view.visible.tolist()]
    assert not found.view.mean2d[rows].any() and not found.view.mean_t[rows].any()


@pytest.mark.parametrize(
    ("name", "image", "gradients"),
    [
        # α' up to 0.999, not 0.99: at most 0.009 of a colour, measured 0.0018
        ("opaque", 0.009, 0.05),
        # its Jacobian is clamped at 0.15 image widths beyond the image, ours at 0.3 of the principal point's distance
        ("off centre", 0.1, 0.5),
        # float32 entries of Σ2d, whose determinant cancels; float64 below
        ("needles", 0.02, 0.02),
    ],
)
def test_differences_of_convention_are_bounded(name: str, image: float, gradients: float):
    scene = DIFFERENT[name]()
    truth, weights = by_reference(scene)
    found = by_engine(GsplatRasterizer(CPU), scene, weights, torch.float32)
    assert EXACT < image_error(found, truth, scene) < image
    assert gradient_error(found, truth) < gradients


def test_needles_differ_by_rounding_alone():
    scene = DIFFERENT["needles"]()
    truth, weights = by_reference(scene)
    found = by_engine(GsplatRasterizer(CPU), scene, weights, torch.float64)
    assert image_error(found, truth, scene) < 1e-10 and gradient_error(found, truth) < 1e-10


def test_a_view_has_one_backward_pass():
    gaussians, request = of_kind("full")
    engine, gradients = GsplatRasterizer(CPU), Gradients.zeros_like(gaussians)
    d_color = torch.ones(3, request.camera.height, request.camera.width, dtype=torch.float64)
    engine.render(gaussians, request, differentiable=False)
    with pytest.raises(RuntimeError, match="must follow"):
        engine.backward(gradients, d_color=d_color)
    engine.render(gaussians, request)
    engine.backward(gradients, d_color=d_color)
    with pytest.raises(RuntimeError, match="must follow"):
        engine.backward(gradients, d_color=d_color)


def test_a_gradient_of_what_was_not_rendered_is_refused():
    gaussians, request = of_kind("static")
    engine = GsplatRasterizer(CPU)
    engine.render(gaussians, request)
    with pytest.raises(ValueError, match="d_stats: expected 'stats' among the outputs"):
        engine.backward(Gradients.zeros_like(gaussians), d_stats=torch.ones(2, 37, 45, dtype=torch.float64))
