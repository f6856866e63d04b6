"""The reference implementation of the rasterizer: PyTorch, any floating-point type, same arguments as the kernel."""

from rasterizer.reference.render import rasterize

__all__ = ["rasterize"]
