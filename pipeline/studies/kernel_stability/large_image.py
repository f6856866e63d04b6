"""An image of 8192 × 8192 pixels, compared at random pixels."""

from __future__ import annotations

import torch

from pipeline.studies.kernel_stability.cases import BOUND
from pipeline.studies.kernel_stability.checks import Check
from pipeline.studies.kernel_stability.sampled import errors_at
from pipeline.studies.kernel_stability.scenes import COUNT, DISTANCE, base_gaussians, base_request, camera_at, generator
from rasterizer.reference.discontinuities import away_from_discontinuities

SIZE, PIXELS = 8192, 20_000


def large_image_check() -> Check:
    camera = camera_at(DISTANCE, SIZE, SIZE, 0.9 * SIZE)
    request = base_request(camera=camera, outputs=("color", "alpha", "depth"))
    gaussians = away_from_discontinuities(base_gaussians(COUNT, 0).to(torch.float32).to(torch.float64), request)
    pixels = torch.randint(SIZE, (PIXELS, 2), generator=generator(1))
    image, gradient, compared = errors_at(gaussians, request, pixels)
    return Check(f"{SIZE} × {SIZE}", f"{len(gaussians)} Gaussians, {compared} pixels", image, gradient, BOUND, BOUND)
