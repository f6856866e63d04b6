""".spz of Niantic, version 3: gzip of fixed-point planes, about a tenth of .ply.

Positions are multiples of 2⁻¹² units of the scene, so that their range is ± 2048 units. Axes are right, up, back:
y and z have the other sign than in 3DGS's files.
"""

from __future__ import annotations

import gzip
import struct

import numpy as np
import torch

from pipeline.export.axes import flipped
from pipeline.export.frame import unit_quaternions
from pipeline.model.model import Model

MAGIC, VERSION = 0x5053474E, 3  # "NGSP"; the last version that is gzip, which the standard library writes
FRACTION_BITS = 12
LARGEST_POSITION = 2.0 ** (23 - FRACTION_BITS)
COLOUR_SCALE = 0.15  # of f_dc in a byte
SH_STEP = 1 / 128  # the format's finest: trained coefficients are small, its default steps of 1/16 and 1/8 drop them
OPACITY_BYTES = (1, 254)  # readers take logits, infinite at 0 and 255; the kernel ends at 0.99 too
QUAT_BITS = 9  # magnitude of a component; its sign is a tenth bit


def spz_bytes(model: Model) -> bytes:
    """The file of a static model. ValueError for positions beyond ± LARGEST_POSITION."""
    p = flipped(model).parameters
    farthest = float(p["mean"].abs().max()) if len(model) else 0.0
    if farthest >= LARGEST_POSITION:
        raise ValueError(
            f"spz: expected positions within ± {LARGEST_POSITION:g}, found {farthest:g}; leave out --world"
        )
    position = np.round(p["mean"].double().numpy() * 2**FRACTION_BITS).astype("<i4")
    planes = [
        position.view(np.uint8).reshape(-1, 3, 4)[:, :, :3],  # the lower three bytes
        _byte((255 * torch.sigmoid(p["opacity_logit"].double())).clamp(*OPACITY_BYTES)),
        _byte(255 * (COLOUR_SCALE * p["sh"][:, 0].double() + 0.5)),
        _byte(16 * (p["log_scale"].double() + 10)),
        _smallest_three(unit_quaternions(p["quat_left"]).numpy()),
        _sh_bytes(p["sh"][:, 1:].double().numpy()),
    ]
    header = struct.pack("<IIIBBBB", MAGIC, VERSION, len(model), model.kind.sh_degree, FRACTION_BITS, 0, 0)
    return gzip.compress(header + b"".join(plane.tobytes() for plane in planes), mtime=0)


def _byte(values: torch.Tensor) -> np.ndarray:
    return np.clip(np.round(values.numpy()), 0, 255).astype(np.uint8)


def _smallest_three(quat: np.ndarray) -> np.ndarray:
    """(N,) uint32 of unit quaternions (N, 4) wxyz: the index of the largest component in two bits (order x, y, z, w),
    then the others, in that order, as sign and magnitude; the quaternion's sign makes the largest positive."""
    xyzw = np.roll(quat, -1, axis=1)
    rows, largest = np.arange(len(xyzw)), np.abs(xyzw).argmax(axis=1)
    xyzw = xyzw * np.where(xyzw[rows, largest] < 0, -1, 1)[:, None]
    magnitude = np.floor((2**QUAT_BITS - 1) * np.sqrt(2) * np.abs(xyzw) + 0.5).astype(np.uint32)
    component = (xyzw < 0).astype(np.uint32) << QUAT_BITS | np.minimum(magnitude, 2**QUAT_BITS - 1)
    packed = largest.astype(np.uint32)
    for axis in range(4):
        packed = np.where(largest == axis, packed, packed << (QUAT_BITS + 1) | component[:, axis])
    return packed.astype("<u4")


def _sh_bytes(rest: np.ndarray) -> np.ndarray:
    """(N, K - 1, 3) uint8: 128 + k / SH_STEP."""
    return np.clip(np.round(rest / SH_STEP) + 128, 0, 255).astype(np.uint8)
