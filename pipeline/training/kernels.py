"""The compiled rasterizer and loss of a training run, with their scratch memory."""

from __future__ import annotations

from rasterizer import Rasterizer
from rasterizer.loss import PhotometricLoss


class Kernels:
    """Rasterizer and loss; their memory is reused for every view."""

    def __init__(self, mse_weight: float, threads: int) -> None:
        self.rasterizer = Rasterizer(threads=threads)
        self.criterion = PhotometricLoss(mse_weight=mse_weight, threads=threads)
        self.threads = threads
