"""A differentiable rasterizer of 4D Gaussians for CPUs: tensors in, tensors out.

`rasterize` is the C++ kernel under autograd; `rasterizer.reference.rasterize` is its reference implementation in plain
PyTorch. `Rasterizer` is the kernel without autograd, for training loops.
"""

from rasterizer.autograd import rasterize
from rasterizer.camera import Camera
from rasterizer.engine import Engine, engine_for, render_batch
from rasterizer.gaussians import Gaussians
from rasterizer.gradients import Gradients, ViewGradient
from rasterizer.rasterizer import Rasterizer
from rasterizer.request import RenderOutput, Request

__all__ = [
    "Camera",
    "Engine",
    "Gaussians",
    "Gradients",
    "Rasterizer",
    "RenderOutput",
    "Request",
    "ViewGradient",
    "engine_for",
    "rasterize",
    "render_batch",
]
