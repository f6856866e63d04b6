"""A call of `rasterize` as JSON, so that it can be saved: random tensors of a seed, edits of them, and plain values.

    {"count": 17, "motion": "full", "fourier_order": 2, "sh_degree": 3, "seed": 0,
     "edits": [["log_scale", "row", 3, 1e20], ["sh", "form", 0, "strided"], …],
     "camera": {"width": 20, …, "distance": 4.0}, "arguments": {"time": 0.5, …}}

Values without a JSON type are {"numpy": type, "value": x} or {"tensor": values}.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from fuzz.model_checks import random_model
from rasterizer import Camera, Gaussians

FIELDS = tuple(Gaussians.__dataclass_fields__)
VALUES = ("all", "row", "entry", "times")  # the part that an edit sets to a number; times: multiplies all by it
FORMS = (
    "gradient", "offset", "strided", "expanded", "negated", "sparse", "double", "half", "whole", "numpy", "list",
    "none", "scalar", "deeper", "shorter", "wider", "meta",
)  # the forms an edit can give a tensor  # fmt: skip


def plain_call() -> dict[str, Any]:
    return {
        "count": 17,
        "motion": "full",
        "fourier_order": 2,
        "sh_degree": 3,
        "seed": 0,
        "edits": [],
        "camera": {"width": 20, "height": 17, "fx": 20.0, "fy": 21.0, "cx": 10.0, "cy": 8.0, "distance": 4.0},
        "arguments": {
            "time": 0.5,
            "duration": 1.0,
            "background": [0.1, 0.2, 0.3],
            "outputs": ["color", "depth"],
            "flow_dt": 0.1,
            "marginal_offset": 0.0,
            "near": 0.2,
            "sh_degree": None,
            "fourier_order": None,
            "threads": 1,
        },
        "flow_camera": None,
    }


def gaussians_of(call: dict[str, Any]) -> Gaussians:
    """The Gaussians of a call; raises the ValueError of invalid tensors."""
    orders = 0 if call["motion"] == "static" else call["fourier_order"]
    model = random_model(call["motion"], orders, call["sh_degree"], call["count"], call["seed"])
    parts: dict[str, Any] = {name: model.parameters.get(name) for name in FIELDS}
    parts["log_scale"] = 0.3 * parts["log_scale"] - 1.5  # small, so that they do not all overlap
    for name, kind, place, value in call["edits"]:
        if isinstance(parts[name], Tensor):
            parts[name] = _formed(parts[name], value) if kind == "form" else _valued(parts[name], kind, place, value)
    return Gaussians(**parts)


def _valued(tensor: Tensor, kind: str, place: int, value: float) -> Tensor:
    tensor = tensor.clone()
    if tensor.numel() and kind == "entry":
        tensor.view(-1)[place % tensor.numel()] = value
    elif tensor.numel() and kind == "row":
        tensor[place % len(tensor)] = value
    elif kind == "all":
        tensor.fill_(value)
    elif kind == "times":
        tensor *= value
    return tensor


def _formed(tensor: Tensor, form: str) -> Any:
    if form == "offset":  # contiguous, not aligned
        return torch.cat([tensor.new_zeros(1), tensor.reshape(-1)])[1:].view(tensor.shape)
    if form == "strided":
        return torch.stack([tensor, tensor], dim=-1)[..., 0]
    made = {
        "gradient": lambda: tensor.requires_grad_(),
        "expanded": lambda: tensor[:1].expand_as(tensor),
        "negated": lambda: torch._neg_view(tensor),
        "sparse": lambda: tensor.to_sparse(),
        "double": tensor.double,
        "half": tensor.half,
        "whole": tensor.int,
        "numpy": tensor.numpy,
        "list": tensor.tolist,
        "none": lambda: None,
        "scalar": lambda: tensor.sum(),
        "deeper": lambda: tensor[None],
        "shorter": lambda: tensor[:-1],
        "wider": lambda: torch.cat([tensor, tensor[..., :1]], dim=-1),
        "meta": lambda: tensor.to("meta"),
    }
    return made[form]()


def camera_of(call: dict[str, Any]) -> Camera:
    """The camera of a call: its world_to_cam, or a fixed rotation at `distance` from the origin."""
    return _camera(call["camera"])


def _camera(description: dict[str, Any]) -> Camera:
    described = {name: decoded(value) for name, value in description.items()}
    distance = described.pop("distance")
    if "world_to_cam" not in described:
        pose = np.eye(4)
        pose[:3, :3] = [[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]]
        pose[2, 3] = distance
        described["world_to_cam"] = pose
    return Camera(**described)


def arguments_of(call: dict[str, Any]) -> dict[str, Any]:
    arguments = {name: decoded(value) for name, value in call["arguments"].items()}
    later = call.get("flow_camera")  # which older regressions lack
    return arguments | ({"flow_camera": _camera(later)} if later else {})


def decoded(value: Any) -> Any:
    """The value of a JSON-encoded argument."""
    if isinstance(value, dict) and "numpy" in value:
        return np.dtype(value["numpy"]).type(value["value"])
    if isinstance(value, dict) and "tensor" in value:
        return torch.tensor(value["tensor"])
    return value
