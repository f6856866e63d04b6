"""Files of all of time, as Gaussians that move on lines and fade: .ftgs.ply, .splatv and .4dgs.

.ftgs.ply  ftgs-player, version 1: .ply of float32 with a time, a duration and a velocity for each Gaussian. Times are
           normalised to [0, 1] over the scene. The player has no threshold of p(t): it still shows what this program's
           kernel culls below 0.05
.splatv    gsplat.js and splaTV: 64 bytes a Gaussian, half precision, colours of 8 bits, no spherical harmonics. The
           player's opacity is α exp(-((t - c)/s)²), so that s = √2 σt; it ends where that exponential is below 0.02
.4dgs      avala-ai/4dgs, by its own library: quantised within stated bounds and compressed
"""

from __future__ import annotations

import io
import json
import math
import struct
from typing import Any

import numpy as np
import torch
from plyfile import PlyData, PlyElement
from torch import Tensor

from pipeline.export.source import Timeline
from pipeline.export.splats import MovingGaussians, colours, logit
from rasterizer import Camera


def _channel_major(sh: Tensor) -> Tensor:
    """(N, 3 (K - 1)): the coefficients but the first."""
    return sh[:, 1:].transpose(1, 2).flatten(1)


def _degree(rest: Tensor) -> int:
    """Of `_channel_major` coefficients."""
    return round((1 + rest.shape[1] / 3) ** 0.5) - 1


# ---- .ftgs.ply ----


def ftgs_bytes(moving: MovingGaussians, line: Timeline) -> bytes:
    """The file of moving Gaussians."""
    sigma = moving.sigma / line.duration
    rest = _channel_major(moving.sh)
    groups = {
        ("x", "y", "z"): moving.mean,
        ("nx", "ny", "nz"): torch.zeros_like(moving.mean),
        tuple(f"f_dc_{c}" for c in range(3)): moving.sh[:, 0],
        tuple(f"f_rest_{i}" for i in range(rest.shape[1])): rest,
        ("opacity",): logit(moving.opacity)[:, None],
        tuple(f"scale_{i}" for i in range(3)): moving.log_scale,
        tuple(f"rot_{i}" for i in range(4)): moving.quat,
        ("time",): ((moving.time - line.start) / line.duration)[:, None],
        ("log_duration",): sigma.log()[:, None],
        tuple(f"velocity_{i}" for i in range(3)): moving.velocity * line.duration,
    }
    names = [name for group in groups for name in group]
    rows = np.zeros(len(moving), [(name, "<f4") for name in names])
    for group, tensor in groups.items():
        for index, name in enumerate(group):
            rows[name] = tensor[:, index]
    comments = [
        "ftgs_version 1",
        "time_units normalized",
        f"sh_degree {_degree(rest)}",
        "use_velocity 1",
        f"min_duration {min(0.02, float(sigma.min())) if len(moving) else 0.02:.6g}",  # 0.02 is the format's own
        "opacity_floor 0",
        f"n_frames {line.frames}",
    ]
    file = io.BytesIO()
    PlyData([PlyElement.describe(rows, "vertex")], byte_order="<", comments=comments).write(file)
    return file.getvalue()


# ---- .splatv ----

SPLATV_MAGIC = 0x674B
TEXTURE_WIDTH = 4096  # texels of 16 bytes, four a Gaussian
SPLATV_ROW = np.dtype(
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


def splatv_bytes(moving: MovingGaussians, line: Timeline) -> bytes:
    """The file of moving Gaussians; its time runs from 0 to 1. Largest first, as .splat.

    Half precision: beyond ± 65,504 values become the largest, and times near 1 are multiples of 1/2048.
    """
    order = torch.argsort(-moving.opacity * moving.log_scale.sum(dim=1).exp(), stable=True)
    height = -(-4 * len(moving) // TEXTURE_WIDTH)
    rows = np.zeros(height * TEXTURE_WIDTH // 4, SPLATV_ROW)  # the rest of the texture is transparent
    used = rows[: len(moving)]
    used["mean"] = moving.mean[order]
    used["quat"] = moving.quat[order]
    used["scale"][:, :3] = moving.log_scale[order].exp()
    used["rgba"] = np.round(255 * colours(moving.sh, moving.opacity)[order].numpy())
    used["motion"][:, :3] = _half((moving.velocity * line.duration)[order])
    used["centre"] = _half(((moving.time - line.start) / line.duration)[order])
    used["width"] = _half((2**0.5 * moving.sigma / line.duration)[order])
    cameras = [_entry(line.camera or camera_before(moving.mean))]
    chunk = {"type": "splat", "size": rows.nbytes, "texwidth": TEXTURE_WIDTH, "texheight": height, "cameras": cameras}
    text = json.dumps([chunk]).encode()
    return struct.pack("<II", SPLATV_MAGIC, len(text)) + text + rows.tobytes()


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


def camera_before(means: Tensor) -> Camera:
    """A camera that looks along z at most of the Gaussians, of means (N, 3)."""
    mean = means.double().numpy()
    centre = np.median(mean, axis=0) if len(mean) else np.zeros(3)
    reach = float(np.quantile(np.linalg.norm(mean - centre, axis=1), 0.9)) if len(mean) else 0.0
    pose = np.eye(4)
    pose[:3, 3] = [*-centre[:2], 3 * (reach or 1.0) - centre[2]]
    return Camera(1000, 1000, 1000.0, 1000.0, 500.0, 500.0, pose)


def _half(values: Tensor) -> np.ndarray:
    largest = float(np.finfo(np.float16).max)
    return values.clamp(-largest, largest).numpy().astype("<f2")


# ---- .4dgs ----

SH_LOW, SH_HIGH = -4.0, 4.0  # the format's range of a coefficient's byte


def fourdgs_bytes(moving: MovingGaussians, line: Timeline) -> bytes:
    """The file of moving Gaussians. ValueError where the library is not installed."""
    try:
        import fourdgs
    except ImportError:
        raise ValueError("4dgs: expected the library fourdgs, found none; pip install fourdgs") from None
    rate = line.seconds / line.duration
    rest = _channel_major(moving.sh)
    code = np.clip(np.round((rest.numpy() - SH_LOW) * 255 / (SH_HIGH - SH_LOW)), 0, 255).astype(np.uint8)
    whole = torch.tensor([[-math.inf, math.inf]], dtype=torch.float64).expand(len(moving), 2)
    window = (((whole if moving.window is None else moving.window) - line.start) * rate).numpy()
    end = np.nextafter(line.seconds, np.inf)  # the end itself is seen
    gaussians = fourdgs.GaussianSet(
        positions=moving.mean.numpy().astype(np.float32),
        scales=moving.log_scale.exp().numpy().astype(np.float32),
        rotations=moving.quat.roll(-1, dims=1).numpy().astype(np.float32),  # xyzw
        colors=colours(moving.sh, moving.opacity).numpy().astype(np.float32),
        motions=(moving.velocity / rate).numpy().astype(np.float32),
        mu_t=((moving.time - line.start) * rate).numpy().astype(np.float32),
        sigma_t=(moving.sigma * rate).numpy().astype(np.float32),
        win_lo=np.maximum(window[:, 0], 0.0),
        win_hi=np.where(window[:, 1] < line.seconds, window[:, 1], end),
        sh=code if code.shape[1] else None,
        sh_degree=_degree(rest),
    )
    file = io.BytesIO()
    fourdgs.write(file, gaussians, line.seconds, options=fourdgs.WriteOptions(profile="fine"))
    return file.getvalue()
