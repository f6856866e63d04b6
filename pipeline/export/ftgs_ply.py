""".ftgs.ply, version 1, of ftgs-player: .ply of float32 with a time, a duration and a velocity for each Gaussian.

Times are normalised to [0, 1] over the scene. The player has no threshold of p(t): what this program's kernel leaves
out below 0.05 it still shows.
"""

from __future__ import annotations

import io

import numpy as np
import torch
from plyfile import PlyData, PlyElement

from pipeline.export.frame import logit
from pipeline.export.moving import MovingGaussians


def ftgs_bytes(moving: MovingGaussians, time_start: float, duration: float, frames: int) -> bytes:
    """The file of moving Gaussians. frames: of the sequence, for the player's slider."""
    sigma = moving.sigma / duration
    rest = moving.sh[:, 1:].transpose(1, 2).flatten(1)  # channel major
    groups = {
        ("x", "y", "z"): moving.mean,
        ("nx", "ny", "nz"): torch.zeros_like(moving.mean),
        tuple(f"f_dc_{c}" for c in range(3)): moving.sh[:, 0],
        tuple(f"f_rest_{i}" for i in range(rest.shape[1])): rest,
        ("opacity",): logit(moving.opacity)[:, None],
        tuple(f"scale_{i}" for i in range(3)): moving.log_scale,
        tuple(f"rot_{i}" for i in range(4)): moving.quat,
        ("time",): ((moving.time - time_start) / duration)[:, None],
        ("log_duration",): sigma.log()[:, None],
        tuple(f"velocity_{i}" for i in range(3)): moving.velocity * duration,
    }
    names = [name for group in groups for name in group]
    rows = np.zeros(len(moving), [(name, "<f4") for name in names])
    for group, tensor in groups.items():
        for index, name in enumerate(group):
            rows[name] = tensor[:, index]
    degree = round((1 + rest.shape[1] / 3) ** 0.5) - 1
    comments = [
        "ftgs_version 1",
        "time_units normalized",
        f"sh_degree {degree}",
        "use_velocity 1",
        f"min_duration {min(0.02, float(sigma.min())) if len(moving) else 0.02:.6g}",  # 0.02 is the format's own
        "opacity_floor 0",
        f"n_frames {frames}",
    ]
    file = io.BytesIO()
    PlyData([PlyElement.describe(rows, "vertex")], byte_order="<", comments=comments).write(file)
    return file.getvalue()
