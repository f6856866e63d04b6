"""The compiled parts that training calls, with their scratch memory."""

from __future__ import annotations

from rasterizer import Rasterizer
from rasterizer.loss import L1Ssim


class Kernels:
    """Rasterizer and loss; their memory is reused from view to view."""

    def __init__(self, ssim_weight: float, threads: int) -> None:
        self.rasterizer = Rasterizer(threads=threads)
        self.criterion = L1Ssim(ssim_weight, threads)
        self.threads = threads
