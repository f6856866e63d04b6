"""A differentiable rasterizer of 4D Gaussians for CPUs: tensors in, tensors out.

`rasterize` is the C++ kernel under autograd, `rasterizer.reference.render.rasterize` its readable twin in plain PyTorch.
`Frame` is the kernel without autograd, for training loops.
"""

from rasterizer.arguments import Request
from rasterizer.autograd import rasterize
from rasterizer.camera import Camera
from rasterizer.frame import Frame, Gradients, ViewGradient
from rasterizer.gaussians import Gaussians
from rasterizer.output import RenderOutput

__all__ = ["Camera", "Frame", "Gaussians", "Gradients", "RenderOutput", "Request", "ViewGradient", "rasterize"]
