"""The model alone, half as large: everything but the means in 16 bits.

Half precision holds 11 binary digits: a relative error of 5e-4 in a coefficient or a quaternion, of 0.2 % in a scale
between e^-8 and e^-4, stored as its logarithm. A mean of float16 would stand 5e-4 of its distance from the origin
beside its place, which is not small beside a Gaussian; it stays float32.
"""

from __future__ import annotations

import json
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from pipeline.model import Model, ModelKind

FULL_PRECISION = ("mean",)


def save_compact(path: Path, model: Model, half: bool = True) -> int:
    """Write the model, and return the file's bytes. half: False stores float32 throughout."""
    tensors = {name: tensor.half() if half and tensor.is_floating_point() and name not in FULL_PRECISION else tensor
               for name, tensor in rounded(model).state().items()}
    kind = [model.kind.motion, model.kind.fourier_order, model.kind.sh_degree]
    save_file(tensors, path, metadata={"kind": json.dumps(kind)})
    return path.stat().st_size


def load_compact(path: Path) -> Model:
    """Read it back, as float32. Raises ValueError, one line, when the file is none of `save_compact`'s."""
    try:
        with safe_open(path, framework="pt") as file:
            kind = ModelKind(*json.loads((file.metadata() or {})["kind"]))
            tensors = {name: file.get_tensor(name) for name in file.keys()}
    except (SafetensorError, OSError, KeyError, TypeError, json.JSONDecodeError) as error:
        raise ValueError(f"{path}: expected a compact model, found {error}") from None
    return Model.restored(kind, {name: t.float() if t.dtype == torch.half else t for name, t in tensors.items()})


def rounded(model: Model) -> Model:
    """The model with quaternions of length 1: any length means the same, and one beyond 65504 is no float16."""
    state = dict(model.state())
    for name in ("quat_left", "quat_right"):
        if name in state:
            quat = state[name]
            largest = quat.abs().amax(dim=1, keepdim=True)
            state[name] = torch.where(largest > 0, torch.nn.functional.normalize(quat / largest.clamp(min=1e-38)), quat)
    return Model.restored(model.kind, state)
