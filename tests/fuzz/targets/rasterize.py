"""Target `rasterize`.

Rule: any tensors, camera and arguments give finite images and gradients, whose bits do not depend on the number of
threads, or a ValueError of one line.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn, SearchStrategy
from torch import Tensor

from fuzz.rasterize_call import FIELDS, FORMS, VALUES, arguments_of, camera_of, gaussians_of, plain_call
from fuzz.target import REFUSED, VALID, Changes, Files, Target, check_message, require
from rasterizer import Camera, Gaussians, rasterize

FILE = "call.json"
CHANNELS = {"color": 3, "alpha": 1, "depth": 1, "flow": 2, "stats": 2}
# Limits of float32, of its square and exponential, and of constants of the kernel.
EDGES = (
    0.0, 1e-45, 1.2e-38, 1e-30, 1e-20, 1e-12, 1e-7, 1e-3, 0.05, 0.2, 0.5, 1.0, 3.0, 10.0, 40.0, 44.0, 80.0, 88.0,
    89.0, 104.0, 1e3, 1e5, 1e7, 1e9, 1e12, 1e15, 1.8e19, 1e20, 1e30, 1e37, 3.4028234e38,
)  # fmt: skip
NUMBERS = st.sampled_from(EDGES) | st.sampled_from(EDGES).map(lambda x: -x) | st.floats(-10, 10) | st.floats(width=32)
LENGTHS = st.sampled_from([edge for edge in EDGES for _ in range(4)] + [-1.0, float("inf")])
ODD = st.sampled_from((
    None, True, "0.5", "", [], {}, [1.0, 2.0], float("nan"), float("inf"), 1e39, 1e300, -1e300, 2**70, 10**400,
    {"numpy": "float32", "value": 0.5}, {"numpy": "int64", "value": 2}, {"numpy": "complex64", "value": 1.0},
    {"tensor": 0.5}, {"tensor": [0.5, 0.5]}, {"tensor": []},
))  # fmt: skip
SIDES = st.sampled_from((1, 2, 3, 15, 16, 17, 33, 64)) | st.integers(1, 80)
LONG = st.sampled_from((4096, 20_000, 65_536))


def example() -> Files:
    return {FILE: json.dumps(plain_call()).encode()}


@st.composite
def calls(draw: DrawFn) -> dict[str, Any]:
    """A mostly valid call, so that it passes the first checks."""
    call = plain_call()
    call["count"] = draw(st.sampled_from((0, 1, 2, 15, 16, 17, 33, 100, 1025)))
    call["motion"] = draw(st.sampled_from(("full", "velocity", "separable", "static")))
    call["fourier_order"], call["sh_degree"] = draw(st.integers(0, 2)), draw(st.integers(0, 3))
    call["seed"] = draw(st.integers(0, 99))
    fields = st.sampled_from(FIELDS)
    values = st.tuples(fields, st.sampled_from(VALUES), st.integers(0, 2000), NUMBERS)
    forms = st.tuples(fields, st.just("form"), st.just(0), st.sampled_from(FORMS))
    call["edits"] = draw(st.lists(values, max_size=4)) + (draw(st.lists(forms, max_size=1)) if _one_in(draw, 4) else [])
    camera, arguments = call["camera"], call["arguments"]
    camera["width"], camera["height"] = draw(SIDES), draw(SIDES)
    if _one_in(draw, 12):
        long, short = draw(st.permutations(("width", "height")))
        camera[long], camera[short] = draw(LONG), draw(st.integers(1, 3))
    for name in ("fx", "fy", "cx", "cy", "distance"):
        if _one_in(draw, 8):
            camera[name] = draw(LENGTHS)
    arguments["outputs"] = draw(st.lists(st.sampled_from(tuple(CHANNELS)), min_size=1, max_size=5))
    if call["motion"] == "static":
        arguments["outputs"] = [name for name in arguments["outputs"] if name != "stats"] or ["color"]
    for name in ("time", "duration", "near", "flow_dt", "marginal_offset"):
        if _one_in(draw, 3):
            arguments[name] = draw(LENGTHS if name in ("duration", "near") else NUMBERS)
    if _one_in(draw, 3):
        call["flow_camera"] = dict(camera)
        for name in ("fx", "fy", "cx", "cy", "distance"):
            if _one_in(draw, 4):
                call["flow_camera"][name] = draw(LENGTHS)
    arguments["background"] = draw(st.lists(NUMBERS, min_size=3, max_size=3)) if _one_in(draw, 3) else [0.1, 0.2, 0.3]
    for name in ("sh_degree", "fourier_order"):
        if _one_in(draw, 4):
            arguments[name] = draw(st.integers(0, call[name]))
    if _one_in(draw, 6):
        holder, name = draw(
            st.sampled_from([(holder, name) for holder in (camera, arguments) for name in holder if name != "distance"])
        )
        holder[name] = draw(ODD | st.integers(-2, 5) | st.sampled_from((65_537, 2**31, -1)))
    if _one_in(draw, 20):
        camera["world_to_cam"] = draw(ODD | st.lists(st.lists(NUMBERS, min_size=4, max_size=4), min_size=4, max_size=4))
    return call


def _one_in(draw: DrawFn, count: int) -> bool:
    return draw(st.integers(0, count - 1)) == count - 1


def changes(files: Files) -> SearchStrategy[Changes]:
    return calls().map(lambda call: {FILE: json.dumps(call).encode()})


def check(folder: Path) -> str:
    call = json.loads((folder / FILE).read_bytes())
    try:
        gaussians, camera, arguments = gaussians_of(call), camera_of(call), arguments_of(call)
        images = _images(gaussians, camera, arguments)
    except ValueError as error:
        check_message(str(error), "", "")
        return REFUSED
    for name, image in images.items():
        require(
            image.dtype == torch.float32 and tuple(image.shape) == (CHANNELS[name], camera.height, camera.width),
            f"{name} is {image.dtype} {list(image.shape)}",
        )
        require(bool(torch.isfinite(image).all()), f"{name} is not finite")
    if "alpha" in images:
        require(images["alpha"].min() >= 0 and images["alpha"].max() <= 1, "alpha outside [0, 1]")
    if "depth" in images:
        require(images["depth"].min() >= 0, "depth below 0")
    # Copies in other memory, with another number of threads.
    copies = Gaussians(
        **{
            "quat_right": None,
            **{name: torch.resolve_neg(tensor.detach()).clone() for name, tensor in gaussians.tensors().items()},
        }
    )
    other = {**arguments, "threads": 3}
    _require_same(images, _images(copies, camera, other), "images of copies, with other threads")
    try:
        gradients = _gradients(gaussians, camera, arguments, call["seed"])
    except ValueError as error:
        check_message(str(error), "", "")
        return "without gradients"
    for name, gradient in gradients.items():
        require(
            gradient.shape == getattr(gaussians, name).shape and bool(torch.isfinite(gradient).all()),
            f"the gradient of {name} is not finite",
        )
    _require_same(gradients, _gradients(copies, camera, other, call["seed"]), "gradients with other threads")
    return VALID


def _images(gaussians: Gaussians, camera: Camera, arguments: dict[str, Any]) -> dict[str, Tensor]:
    with torch.no_grad():
        out = rasterize(gaussians, camera, **arguments)
    return {name: getattr(out, name) for name in CHANNELS if getattr(out, name) is not None}


def _gradients(gaussians: Gaussians, camera: Camera, arguments: dict[str, Any], seed: int) -> dict[str, Tensor]:
    """Gradients of Σ weights · images, with random weights of a seed."""
    leaves = {name: tensor.detach().requires_grad_() for name, tensor in gaussians.tensors().items()}
    out = rasterize(Gaussians(**{"quat_right": None, **leaves}), camera, **arguments)
    generator = torch.Generator().manual_seed(seed)
    images = [getattr(out, name) for name in CHANNELS if getattr(out, name) is not None]
    weights = [torch.randn(image.shape, generator=generator) for image in images]
    found = torch.autograd.grad(images, list(leaves.values()), weights)
    return dict(zip(leaves, found))


def _require_same(one: dict[str, Tensor], two: dict[str, Tensor], what: str) -> None:
    for name in one:
        require(torch.equal(one[name].view(torch.int32), two[name].view(torch.int32)), f"{name} differs: {what}")


TARGET = Target(
    "rasterize", "rasterize: any tensors, camera and arguments, images and gradients", example, changes, check
)
