"""How far an engine's images, gradients and statistics are from the float64 reference and the kernel."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import torch
from builders import (
    camera_looking_at,
    generator,
    make_request,
    output_weights,
    outputs_of,
    random_gaussians,
    render_and_gradients,
)
from torch import Tensor

from rasterizer import Gaussians, Gradients, Rasterizer, Request, ViewGradient
from rasterizer.gsplat_rasterizer import GsplatRasterizer
from rasterizer.on_device import sh_gradient
from rasterizer.reference import render as reference
from rasterizer.reference.discontinuities import away_from_discontinuities, smooth_pixels
from rasterizer.request import RenderOutput

Scene = tuple[Gaussians, Request]  # float64, without Gaussians near a discontinuity
STATISTICS = ("mean2d", "mean_t", "radius")


@dataclass(frozen=True)
class Result:
    """What one engine makes of a scene; all tensors on the CPU."""

    images: dict[str, Tensor]
    gradients: dict[str, Tensor]  # by parameter, 4DSH included
    view: ViewGradient | None = None
    alive: int = 0


def centred(request: Request) -> Request:
    """The principal point in the middle of the image, where the clamps of the Jacobian are the same."""
    camera = request.camera
    return replace(request, camera=replace(camera, cx=camera.width / 2, cy=camera.height / 2))


def of_kind(motion: str, count: int = 70, seed: int = 2, **changes) -> Scene:
    """Random Gaussians with all outputs."""
    request = centred(make_request(outputs=outputs_of(motion), flow_dt=0.2, **changes))
    return away_from_discontinuities(random_gaussians(count, motion, generator(seed)), request), request


def around_the_camera() -> Scene:
    """Means behind the camera, before the near plane, beyond the clamp of the Jacobian; splats wider than the image."""
    gaussians = random_gaussians(150, "full", generator(10), log_scale=(-6.0, 0.3))
    request = make_request(camera=camera_looking_at((0.2, 0.1, -0.6), focal=30.0), outputs=("color", "depth"))
    gaussians = away_from_discontinuities(gaussians, request)
    assert (reference.world_to_camera(gaussians.mean[:, :3], request.camera)[:, 2] < 0).sum() > 20
    return gaussians, request


def at_the_ends_of_lives() -> Scene:
    """p(t) between 0.05 and 0.06, so that many have α p(t) below 1/255 or hardly above."""
    gaussians = random_gaussians(100, "velocity", generator(5), opacity_logit=(-4.0, 3.0))
    request = centred(make_request(outputs=outputs_of("velocity"), flow_dt=0.2))
    deviations = torch.linspace(2.373, 2.447, len(gaussians), dtype=torch.float64)  # exp(-½ d²) = 0.06 … 0.05
    gaussians.mean[:, 3] = request.time - deviations * gaussians.log_scale[:, 3].exp()
    return away_from_discontinuities(gaussians.to(torch.float32).to(torch.float64), request, 1e-4), request


def single() -> Scene:
    gaussians = random_gaussians(1, "full", generator(21), opacity_logit=(1.0, 1.1))
    gaussians.mean[:] = torch.tensor([0.1, -0.1, 0.0, 0.4])
    return gaussians.to(torch.float32).to(torch.float64), centred(make_request(outputs=outputs_of("full"), flow_dt=0.2))


def behind() -> Scene:
    gaussians, request = of_kind("full")
    return gaussians, replace(request, camera=camera_looking_at((0, 0, -9), target=(0, 0, -20)))


def dead() -> Scene:
    gaussians, request = of_kind("shared")
    return gaussians, replace(request, time=1e3)


def beside_the_image() -> Scene:
    """In front of the camera and alive, yet in no pixel."""
    gaussians, request = of_kind("velocity")
    gaussians.mean[:, 0] += 1000.0
    return gaussians, request


def opaque() -> Scene:
    """Many α' above 0.99, and pixels that end early."""
    gaussians = random_gaussians(
        600, "full", generator(8), log_scale=(-2.5, -1.0), opacity_logit=(3.0, 8.0), sh_degree=1
    )
    request = centred(make_request(outputs=("color", "alpha")))
    return away_from_discontinuities(gaussians, request), request


def off_centre() -> Scene:
    """Half of the image on one side of the principal point, beyond which the clamps differ."""
    gaussians = random_gaussians(150, "full", generator(10), log_scale=(-4.0, 0.0))
    camera = camera_looking_at((0.2, 0.1, -0.9), focal=30.0, principal=(8.0, 30.0))
    request = make_request(camera=camera, outputs=("color", "alpha"))
    return away_from_discontinuities(gaussians, request), request


def needles() -> Scene:
    """2,500 px long and thinner than a pixel: in the entries of Σ2d the digits of its determinant cancel."""
    gaussians = random_gaussians(40, "full", generator(11), opacity_logit=(-1.0, 0.0))
    gaussians.log_scale[:, 0] = math.log(50.0)
    gaussians.log_scale[:, 1:3] = math.log(1e-3)
    request = centred(make_request())
    return away_from_discontinuities(gaussians.to(torch.float32).to(torch.float64), request), request


KINDS = ("full", "velocity", "shared", "separable", "static")
SAME: dict[str, Callable[[], Scene]] = {  # what both conventions render alike
    **{motion: partial(of_kind, motion) for motion in KINDS},
    "marginals of another time": partial(of_kind, "shared", marginal_offset=0.15),
    "ends of lives": at_the_ends_of_lives,
    "one Gaussian": single,
    "lower degree and order": partial(of_kind, "full", sh_degree=1, fourier_order=1),
    "around the camera": around_the_camera,
    "behind the camera": behind,
    "none alive": dead,
    "beside the image": beside_the_image,
}
DIFFERENT: dict[str, Callable[[], Scene]] = {"opaque": opaque, "off centre": off_centre, "needles": needles}


def by_reference(scene: Scene) -> tuple[Result, dict[str, Tensor]]:
    """The float64 truth, and the ∂L/∂image it was made with: random in smooth pixels, zero elsewhere."""
    gaussians, request = scene
    weights = output_weights(request, smooth_pixels(gaussians, request), generator(99))
    out, gradients = render_and_gradients(reference.rasterize, gaussians, request, weights)
    return Result({name: image.detach() for name, image in _images(out, request).items()}, gradients), weights


def by_engine(
    engine: Rasterizer | GsplatRasterizer, scene: Scene, weights: dict[str, Tensor], dtype: torch.dtype
) -> Result:
    device = getattr(engine, "device", torch.device("cpu"))
    (gaussians, request), move = scene, lambda tensor: tensor.to(device=device, dtype=dtype)
    gaussians = Gaussians.from_tensors({name: move(t) for name, t in gaussians.tensors().items()}, gaussians.span)
    out, gradients = engine.render(gaussians, request), Gradients.zeros_like(gaussians)
    view = engine.backward(gradients, **{f"d_{name}": move(weight) for name, weight in weights.items()})
    sh = sh_gradient([view.as_tuple() for view in gradients.views], torch.empty_like(gaussians.sh))
    view = ViewGradient(**{name: tensor.cpu() for name, tensor in vars(view).items()})
    named = {name: tensor.cpu() for name, tensor in (gradients.dense() | {"sh": sh}).items()}
    return Result({name: image.cpu() for name, image in _images(out, request).items()}, named, view, engine.alive)


def image_error(found: Result, truth: Result, scene: Scene) -> float:
    """The largest difference in smooth pixels, relative to the largest value of the output."""
    smooth = smooth_pixels(*scene)
    errors = [
        ((image - truth.images[name]).abs() * smooth).max() / truth.images[name].abs().max().clamp(min=1e-3)
        for name, image in found.images.items()
    ]
    return float(max(errors))


def gradient_error(found: Result, truth: Result) -> float:
    """The largest difference, relative to the largest gradient of the parameter; not finite is infinite."""
    errors = []
    for name, expected in truth.gradients.items():
        if expected.numel():
            error = (found.gradients[name] - expected).abs().max().item()
            errors.append(error / max(expected.abs().max().item(), 1e-9) if math.isfinite(error) else math.inf)
    return max(errors, default=0.0)


def statistics_error(found: Result, kernel: Result) -> float:
    """The largest difference in the Gaussians that both see, relative to the largest value of the statistic."""
    assert found.view is not None and kernel.view is not None
    ours, theirs = (dict(zip(r.view.visible.tolist(), range(10**9))) for r in (kernel, found))
    both = [(ours[row], theirs[row]) for row in ours if row in theirs]
    if not both:
        return 0.0
    kernel_rows, found_rows = map(list, zip(*both))
    errors = []
    for name in STATISTICS:
        truth, value = getattr(kernel.view, name)[kernel_rows], getattr(found.view, name)[found_rows]
        errors.append(float((value - truth).abs().max() / truth.abs().max().clamp(min=1e-9)))
    return max(errors)


def seen_by_one(found: Result, kernel: Result) -> tuple[set[int], set[int]]:
    """Rows that only the kernel sees, and only the engine."""
    assert found.view is not None and kernel.view is not None
    ours, theirs = (set(r.view.visible.tolist()) for r in (kernel, found))
    return ours - theirs, theirs - ours


def _images(out: RenderOutput, request: Request) -> dict[str, Tensor]:
    return {name: getattr(out, name) for name in request.outputs}
