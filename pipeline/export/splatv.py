""".splatv of gsplat.js and splaTV: 64 bytes a Gaussian, half precision, colours of 8 bits, no spherical harmonics.

The player's opacity is α exp(-((t - c)/s)²), so that s = √2 σt; it ends where that exponential is below 0.02.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
import torch

from pipeline.export.frame import colours
from pipeline.export.moving import MovingGaussians
from rasterizer import Camera

MAGIC = 0x674B
TEXTURE_WIDTH = 4096  # texels of 16 bytes, four a Gaussian
ROW = np.dtype(
    [
        ("mean", "<f4", 3),  # at t = c
        ("quat", "<f2", 4),  # wxyz
        ("scale", "<f2", 4),  # the fourth is padding
        ("rgba", "u1", 4),
        ("motion", "<f2", 10),  # linear, quadratic, cubic; padding
        ("spin", "<f2", 4),  # change of the quaternion
        ("centre", "<f2"),
        ("width", "<f2"),
    ]
)


def splatv_bytes(moving: MovingGaussians, time_start: float, duration: float, camera: Camera | None = None) -> bytes:
    """The file of moving Gaussians; its time runs from 0 to 1. Largest first, as .splat.

    camera: that a player begins with; None: one that has the Gaussians before it.

    Half precision: beyond ± 65,504 values become the largest, and times near 1 are multiples of 1/2048.
    """
    order = torch.argsort(-moving.opacity * moving.log_scale.sum(dim=1).exp(), stable=True)
    rgba = torch.cat([colours(moving.sh), moving.opacity[:, None]], dim=1)
    height = -(-4 * len(moving) // TEXTURE_WIDTH)
    rows = np.zeros(height * TEXTURE_WIDTH // 4, ROW)  # the rest of the texture is transparent
    used = rows[: len(moving)]
    used["mean"] = moving.mean[order]
    used["quat"] = moving.quat[order]
    used["scale"][:, :3] = moving.log_scale[order].exp()
    used["rgba"] = np.round(255 * rgba[order].numpy())
    used["motion"][:, :3] = _half((moving.velocity * duration)[order])
    used["centre"] = _half(((moving.time - time_start) / duration)[order])
    used["width"] = _half((2**0.5 * moving.sigma / duration)[order])
    cameras = [_entry(camera or _before(moving))]
    chunk = {"type": "splat", "size": rows.nbytes, "texwidth": TEXTURE_WIDTH, "texheight": height, "cameras": cameras}
    text = json.dumps([chunk]).encode()
    return struct.pack("<II", MAGIC, len(text)) + text + rows.tobytes()


def _entry(camera: Camera) -> dict[str, Any]:
    """A camera as in 3DGS' cameras.json: `rotation` is camera-to-world."""
    return {
        "id": 0,
        "img_name": "0000",
        "width": camera.width,
        "height": camera.height,
        "position": camera.position.tolist(),
        "rotation": camera.world_to_cam[:3, :3].T.tolist(),
        "fx": camera.fx,
        "fy": camera.fy,
    }


def _before(moving: MovingGaussians) -> Camera:
    """A camera that looks along z at most of the Gaussians."""
    mean = moving.mean.double().numpy()
    centre = np.median(mean, axis=0) if len(mean) else np.zeros(3)
    reach = float(np.quantile(np.linalg.norm(mean - centre, axis=1), 0.9)) if len(mean) else 0.0
    pose = np.eye(4)
    pose[:3, 3] = [*-centre[:2], 3 * (reach or 1.0) - centre[2]]
    return Camera(1000, 1000, 1000.0, 1000.0, 500.0, 500.0, pose)


def _half(values: torch.Tensor) -> np.ndarray:
    largest = float(np.finfo(np.float16).max)
    return values.clamp(-largest, largest).numpy().astype("<f2")
