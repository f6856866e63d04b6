"""Binary glTF (.glb) with KHR_gaussian_splatting: float32, +y up, static."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
import torch

from pipeline.export.axes import flipped
from pipeline.export.frame import colours, unit_quaternions
from pipeline.model.model import Model

EXTENSION = "KHR_gaussian_splatting"
FLOAT, UNSIGNED_BYTE, POINTS, ARRAY_BUFFER = 5126, 5121, 0, 34962  # glTF's numbers
SHAPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
RENDERING = {
    "kernel": "ellipse",
    "colorSpace": "srgb_rec709_display",
    "sortingMethod": "cameraDistance",
    "projection": "perspective",
}


def glb_bytes(model: Model) -> bytes:
    """The file of a static model. COLOR_0 is what viewers without the extension show: a point cloud."""
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
        "nodes": [{"mesh": 0}],
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


def _attributes(model: Model) -> dict[str, np.ndarray]:
    p = model.parameters
    alpha = torch.sigmoid(p["opacity_logit"].double())
    rgba = torch.cat([colours(p["sh"].double()), alpha[:, None]], dim=1)
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
    return arrays | {"COLOR_0": np.round(255 * rgba.numpy()).astype(np.uint8)}


def _padded(data: bytes, filler: bytes) -> bytes:
    """Chunks and accessors begin at multiples of 4 bytes."""
    return data + filler * (-len(data) % 4)
