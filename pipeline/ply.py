"""The model as a .ply file that viewers of 3D Gaussian Splatting open, and back without loss.

A static model is exactly 3DGS's file. A 4D model adds properties such viewers skip: `t`, `scale_3` (log time scale),
`rot_right_0..3`, and the coefficients of Fourier order n as `f_fourier<n>_*`; so does one with a sphere round the
scene, `sphere`, 1 for its Gaussians and 0 for the others. An environment map is no Gaussian and is left out. Shown in
such a viewer, a 4D model is the Gaussians' spatial part without conditioning on a time: right for checking an
initialisation, a blur for motion.

Lengths and times are the model's own, canonical ones: training starts from the file a run writes, and far from the
origin float32 would lose what it needs. The run's canonical.json says how they follow from the world's.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from plyfile import PlyData, PlyElement, PlyParseError

from pipeline.model import Model, ModelKind


def save_ply(path: Path, model: Model) -> None:
    """Write binary little-endian float32, one vertex a Gaussian, values before activation (as 3DGS does)."""
    columns = {name: model.parameters[field].reshape(len(model), -1)[:, index].numpy()
               for name, field, index in _layout(model.kind)}
    if model.sphere is not None:
        columns["sphere"] = model.sphere.numpy()
    names = list(columns)
    normals = names.index("f_dc_0")  # 3DGS stores unused normals before the colours
    order = names[:normals] + ["nx", "ny", "nz"] + names[normals:]
    vertices = np.zeros(len(model), dtype=[(name, "<f4") for name in order])
    for name, column in columns.items():
        vertices[name] = column
    PlyData([PlyElement.describe(vertices, "vertex")], byte_order="<").write(str(path))


def load_ply(path: Path) -> Model:
    """Read a file of `save_ply` or of 3DGS. Raises ValueError naming the file and what is missing."""
    try:
        vertices = PlyData.read(str(path))["vertex"].data
    except (PlyParseError, KeyError, OSError) as error:
        raise ValueError(f"{path}: expected a .ply file with vertices, found {error}") from error
    present = set(vertices.dtype.names)
    kind = _kind(path, present)
    parameters = {field: torch.zeros(len(vertices), int(np.prod(row, initial=1)))
                  for field, row in kind.shapes().items()}
    for name, field, index in _layout(kind):
        if name not in present:
            raise ValueError(f"{path}: expected a property {name} of a {kind.motion} model, found none")
        parameters[field][:, index] = torch.from_numpy(np.array(vertices[name], dtype=np.float32))
    parameters = {field: parameters[field].reshape(len(vertices), *row) for field, row in kind.shapes().items()}
    sphere = torch.from_numpy(np.array(vertices["sphere"], dtype=bool)) if "sphere" in present else None
    return Model(kind, parameters, sphere)


def _kind(path: Path, present: set[str]) -> ModelKind:
    rest = sum(name.startswith("f_rest_") for name in present)
    degree = {0: 0, 9: 1, 24: 2, 45: 3}.get(rest)  # 3 ((l+1)² - 1)
    if degree is None:
        raise ValueError(f"{path}: expected 0, 9, 24 or 45 properties f_rest_*, found {rest}")
    fourier = sum(f"f_fourier{n}_0" in present for n in (1, 2))
    motion = "static" if "t" not in present else "full" if "rot_right_0" in present else "separable"
    return ModelKind(motion, fourier, degree)


def _layout(kind: ModelKind) -> list[tuple[str, str, int]]:
    """(property, field, flat index in the field's row), in the file's order.

    `sh` is stored (coefficient, channel); 3DGS's f_rest is channel major: all of red, then green, then blue.
    """
    per_order = (kind.sh_degree + 1) ** 2
    layout = [(axis, "mean", i) for i, axis in enumerate("xyzt"[: kind.dims])]
    layout += [(f"f_dc_{c}", "sh", c) for c in range(3)]
    rest = [(k, c) for c in range(3) for k in range(1, per_order)]
    layout += [(f"f_rest_{i}", "sh", 3 * k + c) for i, (k, c) in enumerate(rest)]
    for n in range(1, kind.fourier_order + 1):
        every = [(n * per_order + k, c) for c in range(3) for k in range(per_order)]
        layout += [(f"f_fourier{n}_{i}", "sh", 3 * k + c) for i, (k, c) in enumerate(every)]
    layout += [("opacity", "opacity_logit", 0)]
    layout += [(f"scale_{i}", "log_scale", i) for i in range(kind.dims)]
    layout += [(f"rot_{i}", "quat_left", i) for i in range(4)]
    if kind.motion == "full":
        layout += [(f"rot_right_{i}", "quat_right", i) for i in range(4)]
    return layout
