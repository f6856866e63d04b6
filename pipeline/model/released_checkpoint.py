"""Checkpoints of the released program (chkpnt30000.pth): read and written, in the coordinates of the data's files.

The file is torch's, of (fields, iteration); FIELDS names the fields in their order. It is read by torch's loader of
plain data, which runs no code of the file. Four things differ from our parameters:

- its 4D rotation acts on (t, z, y, x): ql = (a, b, c, d) and qr = (p, q, r, s) are our (a, -b, c, -d), (p, -q, r, s);
- without 4D rotation it stores the logarithm of the variance in time, not of the standard deviation;
- coefficients of 4DSH beyond the active degrees are stored, but not used;
- its environment map lies on a sphere of radius 60 around the origin, with poles on z. Ours is infinitely far away: a
  camera at distance d from the origin sees it turned by up to d / 60 rad.

The file lacks the duration T of the scene, which is that of the data, and `prefilter_var`, which is assumed to be off,
its default. No checkpoint of the authors was at hand: the layout is that of the program's source (its capture()).
"""

from __future__ import annotations

import codecs
import io
import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor
from torch.nn import Parameter

from datasets.files.errors import DataError
from pipeline.model.environment_map import EnvironmentMap
from pipeline.model.model import Model, ModelKind

STATIC_FIELDS = (
    "active_sh_degree", "xyz", "features_dc", "features_rest", "scaling", "rotation", "opacity", "max_radii2d",
    "xyz_gradient_accum", "denom", "optimizer", "spatial_lr_scale",
)  # fmt: skip
FIELDS = (
    "active_sh_degree", "xyz", "features_dc", "features_rest", "scaling", "rotation", "opacity", "max_radii2d",
    "xyz_gradient_accum", "t_gradient_accum", "denom", "optimizer", "spatial_lr_scale", "t", "scaling_t", "rotation_r",
    "rot_4d", "env_map", "active_sh_degree_t",
)  # fmt: skip
LEFT_SIGNS, RIGHT_SIGNS = (1.0, -1.0, 1.0, -1.0), (1.0, -1.0, 1.0, 1.0)
PER_ORDER = 16  # coefficients of a Fourier order: its spherical harmonics have degree 3
COEFFICIENTS = {1: 0, 4: 1, 6: 1, 9: 2, 16: 3, 32: 3, 33: 3, 48: 3}  # number -> degree; of 6 and 33 some are unused
# Its optimizer's groups of parameters, in their order.
GROUPS = ("xyz", "features_dc", "features_rest", "opacity", "scaling", "rotation", "t", "scaling_t", "rotation_r")
GROUP_NAMES = {"features_dc": "f_dc", "features_rest": "f_rest"}

# The extent of the cameras is a NumPy scalar. Its module was called otherwise before NumPy 2.
_SCALAR: Any = np.float64(0).__reduce__()[0]
SAFE_GLOBALS: list[Any] = [
    _SCALAR, (_SCALAR, "numpy.core.multiarray.scalar"), np.dtype, np.dtypes.Float64DType, np.dtypes.Float32DType,
    codecs.encode,
]  # fmt: skip


def load_released(path: Path) -> Model:
    """The model of a checkpoint. DataError for anything else."""
    stored = _fields(path)
    try:
        return _model(stored).checked()
    except (KeyError, IndexError, TypeError, AttributeError, ValueError, ArithmeticError, RuntimeError) as error:
        raise DataError(path, "Gaussians of the released program", str(error)) from None


def released_bytes(model: Model, iteration: int = 0, extent: float = 1.0) -> bytes:
    """A checkpoint that the released program restores and renders; the moments of its optimizer are empty.

    model: in the coordinates of the data's files. extent: of the cameras, which scales learning rates. ValueError for a
    model with an environment map or shared trajectories.
    """
    if model.trajectories is not None:
        raise ValueError(
            "pth: expected a model without shared trajectories, which the released program lacks; use 4dgs"
        )
    if model.environment_map is not None:
        raise ValueError("expected a model without an environment map, which the released program samples otherwise")
    values = _released(model, extent)
    fields = STATIC_FIELDS if model.kind.motion == "static" else FIELDS
    file = io.BytesIO()
    torch.save((tuple(values[name] for name in fields), iteration), file)
    return file.getvalue()


def _fields(path: Path) -> dict[str, Any]:
    """The stored values by name."""
    try:
        with torch.serialization.safe_globals(SAFE_GLOBALS):
            stored = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise
    except Exception as error:  # torch and pickle raise many types for broken files
        refused = re.search(r"GLOBAL (\S+)", str(error))
        found = f"an object {refused[1]}, which is not loaded" if refused else "a file that torch cannot read"
        raise DataError(path, "a checkpoint of the released program", found) from None
    if isinstance(stored, (tuple, list)) and len(stored) == 2 and isinstance(stored[0], (tuple, list)):
        for fields in (FIELDS, STATIC_FIELDS):
            if len(stored[0]) == len(fields):
                return dict(zip(fields, stored[0]))
    raise DataError(
        path,
        f"(fields, iteration) with {len(FIELDS)} fields, or {len(STATIC_FIELDS)} of a static model",
        f"{type(stored).__name__} {f'of {len(stored)}' if isinstance(stored, (tuple, list, dict)) else ''}",
    )


def _model(stored: dict[str, Any]) -> Model:
    mean = _tensor(stored, "xyz", 3)
    if len(mean) == 0:
        raise ValueError("expected at least one Gaussian, found none")
    parameters = {
        "mean": mean,
        "log_scale": _tensor(stored, "scaling", 3),
        "quat_left": _tensor(stored, "rotation", 4),
        "opacity_logit": _tensor(stored, "opacity", 1)[:, 0],
    }
    order = 0
    if "t" in stored:
        rotates, order = bool(stored["rot_4d"]), int(stored["active_sh_degree_t"])
        log_scale_t = _tensor(stored, "scaling_t", 1) * (1.0 if rotates else 0.5)
        parameters["mean"] = torch.cat([mean, _tensor(stored, "t", 1)], dim=1)
        parameters["log_scale"] = torch.cat([parameters["log_scale"], log_scale_t], dim=1)
        if rotates:
            parameters["quat_left"] = parameters["quat_left"] * torch.tensor(LEFT_SIGNS)
            parameters["quat_right"] = _tensor(stored, "rotation_r", 4) * torch.tensor(RIGHT_SIGNS)
    sh = torch.cat([_tensor(stored, "features_dc", 1, 3), _tensor(stored, "features_rest", None, 3)], dim=1)
    if sh.shape[1] not in COEFFICIENTS:
        raise ValueError(f"expected one of {list(COEFFICIENTS)} SH coefficients, found {sh.shape[1]}")
    degree = COEFFICIENTS[sh.shape[1]]
    per_order, active = (degree + 1) ** 2, (int(stored["active_sh_degree"]) + 1) ** 2
    if sh.shape[1] < per_order * (order + 1):
        raise ValueError(f"expected {per_order * (order + 1)} SH coefficients of order {order}, found {sh.shape[1]}")
    sh = sh[:, : per_order * (order + 1)].unflatten(1, (order + 1, per_order)).clone()
    sh[:, :, active:] = 0.0
    parameters["sh"] = sh.flatten(1, 2)
    motion = "static" if "t" not in stored else "full" if "quat_right" in parameters else "separable"
    image = stored.get("env_map")
    environment_map = None if image is None or len(image) == 0 else _environment_map(image)
    return Model(ModelKind(motion, order, degree), parameters, None, environment_map)  # type: ignore[arg-type]


def _environment_map(image: Tensor) -> EnvironmentMap:
    """From (3, side, side): azimuth atan2(y, x) along its columns, the angle to +z along its rows."""
    if image.dim() != 3 or image.shape[0] != 3 or image.shape[1] != image.shape[2]:
        raise ValueError(f"env_map: expected [3, side, side], found {list(image.shape)}")
    side = image.shape[1]
    azimuth = (torch.arange(2 * side) + 0.5) / side * math.pi - math.pi  # of our map: atan2(x, z)
    latitude = ((torch.arange(side) + 0.5) / side - 0.5)[:, None] * math.pi  # asin(y)
    x, y, z = latitude.cos() * azimuth.sin(), latitude.sin().expand(side, 2 * side), latitude.cos() * azimuth.cos()
    grid = torch.stack([torch.atan2(y, x) / math.pi, 2 * torch.acos(z.clamp(-1, 1)) / math.pi - 1], dim=-1)
    wrapped = F.pad(image.detach().float()[None], (1, 1, 0, 0), mode="circular")  # its seam shows black there
    grid[..., 0] *= side / (side + 2)
    return EnvironmentMap(F.grid_sample(wrapped, grid[None], "bilinear", "border", align_corners=False)[0])


def _tensor(stored: dict[str, Any], name: str, *row: int | None) -> Tensor:
    """A field as float32 (N, *row); ValueError for another shape. None: any length."""
    value = stored[name]
    shape = list(value.shape) if isinstance(value, Tensor) else type(value).__name__
    rows = len(stored["xyz"])
    expected = [rows, *row]
    if not isinstance(value, Tensor) or value.dim() != len(expected):
        raise ValueError(f"{name}: expected {_shape(expected)}, found {shape}")
    if any(side not in (None, found) for side, found in zip(expected, value.shape)):
        raise ValueError(f"{name}: expected {_shape(expected)}, found {shape}")
    return value.detach().to(torch.float32)


def _shape(sides: Iterable[int | None]) -> str:
    return f"[{', '.join('K' if side is None else str(side) for side in sides)}]"


def _released(model: Model, extent: float) -> dict[str, Any]:
    """Every field of the file."""
    p, rows, motion = model.parameters, len(model), model.kind.motion
    sh = p["sh"].unflatten(1, (model.kind.fourier_order + 1, -1))
    if model.kind.fourier_order > 0:  # its kernel expects 16 coefficients an order
        sh = F.pad(sh, (0, 0, 0, PER_ORDER - sh.shape[2]))
    sh = sh.flatten(1, 2)
    rotates = motion == "full"
    values: dict[str, Any] = {
        "xyz": p["mean"][:, :3],
        "features_dc": sh[:, :1],
        "features_rest": sh[:, 1:],
        "scaling": p["log_scale"][:, :3],
        "rotation": p["quat_left"] * torch.tensor(LEFT_SIGNS) if rotates else p["quat_left"],
        "opacity": p["opacity_logit"][:, None],
    }
    if motion != "static":
        values["t"] = p["mean"][:, 3:]
        values["scaling_t"] = p["log_scale"][:, 3:] * (1.0 if rotates else 2.0)
    if rotates:
        values["rotation_r"] = p["quat_right"] * torch.tensor(RIGHT_SIGNS)
    values = {name: Parameter(tensor.clone().contiguous()) for name, tensor in values.items()}
    groups = [
        {"params": [values[name]], "lr": 0.0, "name": GROUP_NAMES.get(name, name)} for name in GROUPS if name in values
    ]
    optimizer = torch.optim.Adam(groups, lr=0.0, eps=1e-15)
    accumulators = {
        name: torch.zeros(rows, 1) for name in ("xyz_gradient_accum", "t_gradient_accum", "denom")
    }  # of densification
    return {
        "rotation_r": torch.empty(0),
        **values,
        **accumulators,
        "max_radii2d": torch.zeros(rows),
        "optimizer": optimizer.state_dict(),
        "spatial_lr_scale": extent,
        "active_sh_degree": math.isqrt(sh.shape[1] // (model.kind.fourier_order + 1)) - 1,
        "active_sh_degree_t": model.kind.fourier_order,
        "rot_4d": rotates,
        "env_map": None,
    }
