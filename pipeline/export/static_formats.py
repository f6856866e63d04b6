"""Files of one frame, a static model: .splat, .spz and .glb. (.ply is pipeline/model/ply.py.)

.splat  antimatter15/splat: 32 bytes a Gaussian, no header, colours of 8 bits, no spherical harmonics
.spz    Niantic, version 3: gzip of fixed-point planes, about a tenth of .ply. Positions are multiples of 2⁻¹² units of
        the scene, so that their range is ± 2048 units. Axes are right, up, back
.glb    binary glTF with KHR_gaussian_splatting: float32, +y up
"""

from __future__ import annotations

import gzip
import json
import struct
from typing import Any

import numpy as np
import torch

from datasets.canonical import Canonical
from pipeline.export.splats import colours, flipped, unit_quaternions
from pipeline.model.model import Model

# ---- .splat ----

SPLAT_ROW = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])


def splat_bytes(model: Model) -> bytes:
    """The file of a static model. Rows are sorted by size × opacity, so that a page shows the largest first."""
    p = model.parameters
    alpha = torch.sigmoid(p["opacity_logit"].double())
    order = torch.argsort(-alpha * p["log_scale"].double().sum(dim=1).exp(), stable=True)
    rows = np.zeros(len(model), SPLAT_ROW)
    rows["mean"] = p["mean"][order]
    rows["scale"] = p["log_scale"][order].double().exp()
    rows["rgba"] = np.round(255 * colours(p["sh"].double(), alpha)[order].numpy())
    rows["quat"] = np.clip(np.round(128 + 128 * unit_quaternions(p["quat_left"])[order].numpy()), 0, 255)
    return rows.tobytes()


# ---- .spz ----

SPZ_MAGIC, SPZ_VERSION = 0x5053474E, 3  # "NGSP"; the last version that is gzip, which the standard library writes
FRACTION_BITS = 12
LARGEST_POSITION = 2.0 ** (23 - FRACTION_BITS)
COLOUR_SCALE = 0.15  # of f_dc in a byte
SPZ_SH_STEP = 1 / 128  # the finest: trained coefficients are small, the default steps of 1/16 and 1/8 drop them
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
        _byte(p["sh"][:, 1:].double() / SPZ_SH_STEP + 128),
    ]
    header = struct.pack("<IIIBBBB", SPZ_MAGIC, SPZ_VERSION, len(model), model.kind.sh_degree, FRACTION_BITS, 0, 0)
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


# ---- .glb ----

EXTENSION = "KHR_gaussian_splatting"
FLOAT, UNSIGNED_BYTE, POINTS, ARRAY_BUFFER = 5126, 5121, 0, 34962  # glTF's numbers
SHAPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
RENDERING = {
    "kernel": "ellipse",
    "colorSpace": "srgb_rec709_display",
    "sortingMethod": "cameraDistance",
    "projection": "perspective",
}


def glb_bytes(model: Model, data_to_file: Canonical | None = None) -> bytes:
    """The file of a static model. COLOR_0 is what viewers without the extension show: a point cloud.

    data_to_file: a shift in it, of the data's coordinates without scale, is the translation of the node.
    """
    if len(model) == 0:
        raise ValueError("glb: expected a Gaussian in the frame at least, found none at this time")
    arrays = _attributes(flipped(model))
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    chunks: list[bytes] = []
    offset = 0
    for name, array in arrays.items():
        data = array.tobytes()
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": len(data), "target": ARRAY_BUFFER})
        accessor: dict[str, Any] = {
            "bufferView": len(accessors),
            "componentType": UNSIGNED_BYTE if array.dtype == np.uint8 else FLOAT,
            "count": len(array),
            "type": SHAPES[1 if array.ndim == 1 else array.shape[1]],
        }
        if array.dtype == np.uint8:
            accessor["normalized"] = True
        if name == "POSITION":
            accessor |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
        accessors.append(accessor)
        chunks.append(_padded(data, b"\0"))
        offset += len(chunks[-1])
    primitive = {
        "mode": POINTS,
        "attributes": {name: index for index, name in enumerate(arrays)},
        "extensions": {EXTENSION: RENDERING},
    }
    document = {
        "asset": {"version": "2.0", "generator": "gaussians-4d"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, **_translation(data_to_file)}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": offset}],
    }
    text, binary = _padded(json.dumps(document).encode(), b" "), b"".join(chunks)
    header = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + len(binary))
    return b"".join(
        [header, struct.pack("<I4s", len(text), b"JSON"), text, struct.pack("<I4s", len(binary), b"BIN\0"), binary]
    )


def _translation(data_to_file: Canonical | None) -> dict[str, list[float]]:
    """Of a node whose axes are `flipped`'s; none for coordinates that are scaled or not shifted."""
    if data_to_file is None or data_to_file.scale != 1.0 or data_to_file.keeps_space:
        return {}
    x, y, z = data_to_file.centre
    return {"translation": [x, -y, -z]}


def _attributes(model: Model) -> dict[str, np.ndarray]:
    p = model.parameters
    alpha = torch.sigmoid(p["opacity_logit"].double())
    found = {
        "POSITION": p["mean"],
        f"{EXTENSION}:ROTATION": unit_quaternions(p["quat_left"]).roll(-1, dims=1),  # xyzw
        f"{EXTENSION}:SCALE": p["log_scale"].double().exp(),
        f"{EXTENSION}:OPACITY": alpha,
    }
    for degree in range(model.kind.sh_degree + 1):
        for index in range(2 * degree + 1):
            found[f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{index}"] = p["sh"][:, degree**2 + index]
    arrays = {name: np.ascontiguousarray(tensor.numpy(), dtype="<f4") for name, tensor in found.items()}
    return arrays | {"COLOR_0": np.round(255 * colours(p["sh"].double(), alpha).numpy()).astype(np.uint8)}


def _padded(data: bytes, filler: bytes) -> bytes:
    """Chunks and accessors begin at multiples of 4 bytes."""
    return data + filler * (-len(data) % 4)
