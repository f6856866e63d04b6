"""Arguments that `Rasterizer` and `rasterize` refuse, each in one line that names it."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from builders import generator, off_centre_camera, random_gaussians
from test_rasterizer import image_gradients, render_and_backward, request_for

from rasterizer import Gradients, Rasterizer, Request, rasterize
from rasterizer.loss import PhotometricLoss


@pytest.mark.parametrize("name", ["mean", "log_scale", "quat_left", "quat_right", "opacity_logit", "sh"])
def test_non_finite_parameters_are_named(name: str):
    for value in (math.nan, math.inf, -math.inf):
        gaussians = random_gaussians(9, "full", generator(8)).to(torch.float32)
        getattr(gaussians, name)[7] = value
        with pytest.raises(ValueError, match=rf"^{name}\[7.*must be finite, got {value}$"):
            rasterize(gaussians, off_centre_camera())


@pytest.mark.parametrize("renderer", [rasterize, lambda g, camera: Rasterizer(threads=1).render(g, Request(camera))])
def test_wrong_types_and_layouts_are_named(renderer):
    gaussians, camera = random_gaussians(9, "full", generator(9)), off_centre_camera()
    with pytest.raises(ValueError, match=r"^mean must be .*float32 \[9, 4\], got float64"):
        renderer(gaussians, camera)
    gaussians = gaussians.to(torch.float32)
    strided = torch.empty(9, 8)[:, ::2].copy_(gaussians.quat_left)
    with pytest.raises(ValueError, match="^quat_left must be .*contiguous"):
        renderer(replace(gaussians, quat_left=strided), camera)


def test_wrong_shapes_are_named():
    gaussians = random_gaussians(9, "full", generator(10)).to(torch.float32)
    for name, tensor, message in (
        ("mean", torch.zeros(9, 5), r"^mean must be \[N, 4\] or, static, \[N, 3\], got \[9, 5\]$"),
        ("log_scale", torch.zeros(9, 3), r"^log_scale must be \[9, 4\], got \[9, 3\]$"),
        ("quat_right", torch.zeros(8, 4), r"^quat_right must be \[9, 4\], got \[8, 4\]$"),
        ("opacity_logit", torch.zeros(9, 1), r"^opacity_logit must be \[9\], got \[9, 1\]$"),
        ("sh", torch.zeros(9, 5, 3), r"^sh must be \[9, .*got \[9, 5, 3\]$"),
    ):
        with pytest.raises(ValueError, match=message):
            replace(gaussians, **{name: tensor})


@pytest.mark.parametrize(
    "changes",
    [
        {"time": math.nan},
        {"time": math.inf},
        {"duration": 0.0},
        {"near": math.nan},
        {"background": (0, 0, math.nan)},
        {"outputs": ("colour",)},
        {"outputs": ("flow",), "flow_dt": None},
        {"sh_degree": 4},
        {"fourier_order": 3},
    ],
)
def test_invalid_requests_are_named(changes: dict):
    name = next(reversed(changes))
    with pytest.raises(ValueError, match=f"^{name} must be "):
        rasterize(random_gaussians(3, "full", generator(11)).to(torch.float32), off_centre_camera(), **changes)


def test_backward_accepts_only_gradients_of_rendered_images():
    gaussians = random_gaussians(9, "full", generator(12)).to(torch.float32)
    rasterizer, gradients = Rasterizer(threads=1), Gradients.zeros_like(gaussians)
    with pytest.raises(RuntimeError, match="must follow Rasterizer.render"):
        rasterizer.backward(gradients)
    rasterizer.render(gaussians, Request(off_centre_camera()))
    with pytest.raises(ValueError, match="d_depth: expected .depth. among the outputs"):
        rasterizer.backward(gradients, d_depth=torch.zeros(1, 37, 45))
    with pytest.raises(ValueError, match=r"d_color must be float32 \[3, 37, 45\], got float32 \[3, 45, 37\]"):
        rasterizer.backward(gradients, d_color=torch.zeros(3, 45, 37))
    image = torch.zeros(3, 37, 45)
    for d_color in (image.double(), image.to("meta"), image.to_sparse()):
        with pytest.raises(ValueError, match="d_color must be float32"):
            rasterizer.backward(gradients, d_color=d_color)
    with pytest.raises(ValueError, match="gradients.mean must be contiguous float32 .*, got float64"):
        rasterizer.backward(Gradients.zeros_like(gaussians.to(torch.float64)), d_color=image)


def test_what_the_kernel_writes_has_room_for_the_gaussians():
    """The kernel writes rows by number, without a look at the length of the array."""
    gaussians, request = random_gaussians(80, "full", generator(15)).to(torch.float32), request_for("full")
    found, (view,) = render_and_backward(gaussians, [request], threads=1)
    last = int(view.visible[-1])
    mask = torch.zeros(last + 1, dtype=torch.uint8)
    view.mark_visible(mask)
    assert mask.nonzero().squeeze(1).tolist() == view.visible.tolist()
    with pytest.raises(ValueError, match=f"mask must have a row for each of {last + 1} Gaussians or more, got {last}"):
        view.mark_visible(mask[:last])
    with pytest.raises(ValueError, match="mask must be contiguous uint8"):
        view.mark_visible(mask.int())
    space, time = torch.zeros(80), torch.zeros(80)
    for wrong in (torch.zeros(79), torch.zeros(80, dtype=torch.float64), torch.zeros(160)[::2]):
        with pytest.raises(ValueError, match=r"views must be contiguous float32 \[80\]"):
            view.accumulate(space, time, wrong, request.camera, 1.0)
    gradients = Gradients.zeros_like(gaussians)
    with pytest.raises(ValueError, match="out must be contiguous float32"):
        gradients.sh(out=torch.zeros(80, 1, 3))
    for call in (view.mark_visible, gradients.sh, gradients.zero_, gradients.all_finite):
        with pytest.raises(ValueError, match="threads must be in 0..1024, got -1"):
            call(*([mask] if call == view.mark_visible else []), threads=-1)


@pytest.mark.parametrize("name", ["camera", "flow_camera"])
def test_a_view_without_a_camera_is_refused(name: str):
    with pytest.raises(ValueError, match=f"^{name} must be a Camera, got 'left'"):
        Request(**{"camera": off_centre_camera(), name: "left"})
    with pytest.raises(ValueError, match="^camera must be a Camera, got None"):
        rasterize(random_gaussians(3, "full", generator(11)).to(torch.float32), None)


def test_backward_rejects_images_changed_in_place():
    """The backward pass reads the rendered images, so a changed image would silently give wrong gradients."""
    gaussians, request = random_gaussians(80, "full", generator(14)).to(torch.float32), request_for("full")
    rasterizer, gradients = Rasterizer(threads=1), Gradients.zeros_like(gaussians)
    image = rasterizer.render(gaussians, request).color
    rasterizer.backward(gradients, **image_gradients(request))
    image.clamp_(0.0, 0.5)
    with pytest.raises(RuntimeError, match="reads the rendered color, which was changed in place"):
        rasterizer.backward(gradients, **image_gradients(request))


def test_gradients_of_other_gaussians_are_refused():
    gaussians = random_gaussians(9, "full", generator(12)).to(torch.float32)
    rasterizer = Rasterizer(threads=1)
    rasterizer.render(gaussians, Request(off_centre_camera()))
    fewer = random_gaussians(8, "full", generator(12)).to(torch.float32)
    separable = random_gaussians(9, "separable", generator(12)).to(torch.float32)
    for other, message in (
        (fewer, r"gradients\.\w+ must be \[9"),
        (separable, r"quat_right must be \[9, 4\], .* got None"),
    ):
        with pytest.raises(ValueError, match=message):
            rasterizer.backward(Gradients.zeros_like(other), d_color=torch.zeros(3, 37, 45))


def test_backward_does_not_follow_a_render_that_failed(monkeypatch):
    gaussians = random_gaussians(9, "full", generator(12)).to(torch.float32)
    rasterizer = Rasterizer(threads=1)
    rasterizer.render(gaussians, Request(off_centre_camera()))

    def fail(*shape):
        raise MemoryError

    monkeypatch.setattr(rasterizer, "_empty", fail)
    with pytest.raises(MemoryError):
        rasterizer.render(gaussians, Request(off_centre_camera()))
    with pytest.raises(RuntimeError, match="must follow Rasterizer.render"):
        rasterizer.backward(Gradients.zeros_like(gaussians))


@pytest.mark.parametrize("threads", [-1, 2000, 1.5])
def test_a_wrong_number_of_threads_is_named(threads):
    for make in (Rasterizer, lambda threads: PhotometricLoss(threads=threads)):
        with pytest.raises(ValueError, match=f"threads must be in 0..1024, got {threads}"):
            make(threads)
