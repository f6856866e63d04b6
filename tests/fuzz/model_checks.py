"""Random small models, and the check of every model that a reader returns."""

from __future__ import annotations

import torch

from fuzz.target import require
from pipeline.model.model import Model, ModelKind
from rasterizer import Camera, Rasterizer, Request
from rasterizer.gaussians import Motion

VIEW = Request(Camera(9, 7, 8.0, 8.0, 4.5, 3.5, torch.eye(4).tolist()), time=0.5)


def random_model(motion: Motion, fourier_order: int, sh_degree: int, count: int, seed: int) -> Model:
    """`count` random Gaussians."""
    kind, generator = ModelKind(motion, fourier_order, sh_degree), torch.Generator().manual_seed(seed)
    return Model(kind, {name: torch.randn(count, *row, generator=generator) for name, row in kind.shapes().items()})


def check_model(model: Model) -> None:
    """RuleViolation unless all tensors are finite float32 of one model that can be rendered."""
    for name, tensor in model.parameters.items():
        require(tensor.dtype == torch.float32 and bool(torch.isfinite(tensor).all()), f"{name} is not finite float32")
    gaussians = model.gaussians()
    kind = (gaussians.motion, gaussians.fourier_order, gaussians.sh_degree)
    require(kind == (model.kind.motion, model.kind.fourier_order, model.kind.sh_degree), f"{model.kind} is {kind}")
    require(model.sphere is None or tuple(model.sphere.shape) == (len(model),), "sphere labels of another length")
    Rasterizer(threads=1).render(gaussians, VIEW)
