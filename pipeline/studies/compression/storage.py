"""Model files in fewer bits: all but means and shared trajectories in float16, optionally SH coefficients in int8.

float16 has 11 significant bits: a relative error of 5e-4 in a coefficient or a quaternion, and of 0.2 % in a scale
between e^-8 and e^-4, stored as its logarithm. A float16 mean would be off by 5e-4 of its distance from the origin,
more than a small Gaussian's size; means stay float32.

int8 stores the SH coefficients other than the first (nine tenths of a Gaussian's numbers) as multiples of 1/127 of
the largest of the Gaussian: an error of at most 0.4 % of the largest.
"""

from __future__ import annotations

import json
from dataclasses import astuple
from pathlib import Path
from typing import Literal, get_args

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from pipeline.model.model import Model, ModelKind

Precision = Literal["float32", "float16", "int8"]
PRECISIONS: tuple[Precision, ...] = get_args(Precision)
FULL_PRECISION = ("mean", "trajectories", "span")
STEPS, STEP = "sh_steps", "sh_step"  # int8: (N, K-1, 3) all coefficients but the first, in multiples of (N, 1, 1)
LEVELS = 127


def save_compressed(path: Path, model: Model, precision: Precision = "float16") -> int:
    """Writes the model; returns the size of the file in bytes."""
    tensors, steps = dict(with_unit_quaternions(model).state()), {}
    if precision == "int8":
        first, others = tensors["sh"][:, :1].contiguous(), tensors["sh"][:, 1:]
        largest = others.abs().flatten(1).amax(dim=1) if others.shape[1] else torch.zeros(len(others))
        step = (largest / LEVELS).clamp(min=torch.finfo(torch.float32).tiny)[:, None, None]
        tensors["sh"], steps = first, {STEPS: (others / step).round().to(torch.int8), STEP: step}
    if precision != "float32":
        tensors = {
            name: tensor.half() if tensor.is_floating_point() and name not in FULL_PRECISION else tensor
            for name, tensor in tensors.items()
        }
    save_file({**tensors, **steps}, path, metadata={"kind": json.dumps(astuple(model.kind))})
    return path.stat().st_size


def load_compressed(path: Path) -> Model:
    """Reads a model back as float32. ValueError, one line, where `save_compressed` did not write the file."""
    try:
        with safe_open(path, framework="pt") as file:
            kind = ModelKind(*json.loads((file.metadata() or {})["kind"]))
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  # no mapping
        tensors = {name: t.float() if t.dtype == torch.half else t for name, t in tensors.items()}
        if STEPS in tensors:
            tensors["sh"] = torch.cat([tensors["sh"], tensors.pop(STEPS) * tensors.pop(STEP)], dim=1)
    except (SafetensorError, OSError, KeyError, TypeError, json.JSONDecodeError) as error:
        raise ValueError(f"{path}: expected a compressed model, found {error}") from None
    return Model.restored(kind, tensors)


def with_unit_quaternions(model: Model) -> Model:
    """The model with normalized quaternions: the same rotations, and no component beyond float16's 65504."""
    state = dict(model.state())
    for name in ("quat_left", "quat_right"):
        if name in state:
            quat = state[name]
            largest = quat.abs().amax(dim=1, keepdim=True)
            state[name] = torch.where(largest > 0, torch.nn.functional.normalize(quat / largest.clamp(min=1e-38)), quat)
    return Model.restored(model.kind, state)
