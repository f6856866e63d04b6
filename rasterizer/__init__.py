"""A differentiable rasterizer of 4D Gaussians for CPUs: tensors in, tensors out.

`rasterize` is the C++ kernel under autograd, `rasterizer.reference.rasterize` its readable twin in plain PyTorch.
`Frame` is the kernel without autograd, for training loops.
"""

from .arguments import Request
from .autograd import rasterize
from .camera import Camera
from .frame import Frame, Gradients, ViewGradient
from .gaussians import Gaussians
from .output import RenderOutput

__all__ = ["Camera", "Frame", "Gaussians", "Gradients", "RenderOutput", "Request", "ViewGradient", "rasterize"]
