"""A differentiable rasterizer of 4D Gaussians for CPUs: tensors in, tensors out.

`rasterize` is the C++ kernel under autograd, `rasterizer.reference.render.rasterize` its readable twin in plain PyTorch.
`Rasterizer` is the kernel without autograd, for training loops.
"""

from rasterizer.arguments import Request
from rasterizer.autograd import rasterize
from rasterizer.camera import Camera
from rasterizer.forward_backward import Gradients, Rasterizer, ViewGradient
from rasterizer.gaussians import Gaussians
from rasterizer.output import RenderOutput

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
