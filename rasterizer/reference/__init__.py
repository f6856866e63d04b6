"""The reference implementation of the rasterizer: plain PyTorch, any floating-point type, the same call as the kernel's."""

from rasterizer.reference.render import rasterize

__all__ = ["rasterize"]
