"""A differentiable rasterizer of 4D Gaussians for CPUs: tensors in, tensors out.

`rasterize` is the C++ kernel under autograd; `rasterizer.reference.rasterize` is its reference implementation in plain
PyTorch. `Rasterizer` is the kernel without autograd, for training loops.
"""

from rasterizer.autograd import rasterize
from rasterizer.camera import Camera
from rasterizer.gaussians import Gaussians
from rasterizer.gradients import Gradients, ViewGradient
from rasterizer.rasterizer import Rasterizer
from rasterizer.render_output import RenderOutput
from rasterizer.request import Request

Frame = Rasterizer  # its name up to version 0.1

__all__ = [
    "Camera",
    "Frame",
    "Gaussians",
    "Gradients",
    "Rasterizer",
    "RenderOutput",
    "Request",
    "ViewGradient",
    "rasterize",
]
