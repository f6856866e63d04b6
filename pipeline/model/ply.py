"""Lossless .ply files of a model, in the format of 3D Gaussian Splatting's viewers.

A static model is exactly 3DGS's file. A 4D model adds properties that such viewers skip: `t`, `scale_3` (log time
scale), `rot_right_0..3`, and the coefficients of Fourier order n as `f_fourier<n>_*`. A model with a sphere adds
`sphere`, 1 for its Gaussians and 0 for the others. An environment map is not stored. A viewer shows the Gaussians'
spatial part, not conditioned on a time: correct for an initialisation, blurred for motion.

Lengths and times are canonical, because training starts from this file and float32 loses precision far from the origin.
The run's canonical.json has the transform from world units. An exported file states its own in a comment:

    comment data_to_file {"centre": [x, y, z], "scale": s, "time_origin": t, "time_scale": r}

of positions (x in the data - centre) scale and times (t in the data - time_origin) time_scale.
"""

from __future__ import annotations

import io
import itertools
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from plyfile import PlyData, PlyElement

from datasets.canonical import Canonical
from datasets.files.errors import DataError
from pipeline.model.model import Model, ModelKind
from pipeline.model.transformed import in_rotations
from rasterizer.gaussians import Motion

COMMENT = "data_to_file"
LONGEST_HEADER, LONGEST_LINE = 1000, 1000  # lines, bytes; a full model has 170 lines


def save_ply(path: Path, model: Model) -> None:
    """Write binary little-endian float32, one vertex per Gaussian, values before activation, as 3DGS does."""
    path.write_bytes(ply_bytes(model))


def ply_bytes(model: Model, data_to_file: Canonical | None = None) -> bytes:
    """The content of `save_ply`'s file. Velocities are written as rotations. ValueError for shared trajectories.

    data_to_file: from the coordinates of the data's files to those of `model`; None: not stated.
    """
    if model.trajectories is not None:
        raise ValueError("expected a model without shared trajectories, which .ply lacks; use its checkpoint")
    model = in_rotations(model)
    columns = {
        name: model.parameters[field].reshape(len(model), -1)[:, index].numpy()
        for name, field, index in _layout(model.kind)
    }
    if model.sphere is not None:
        columns["sphere"] = model.sphere.numpy()
    names = list(columns)
    normals = names.index("f_dc_0")  # 3DGS stores unused normals before the colours
    order = names[:normals] + ["nx", "ny", "nz"] + names[normals:]
    vertices = np.zeros(len(model), dtype=[(name, "<f4") for name in order])
    for name, column in columns.items():
        vertices[name] = column
    file = io.BytesIO()
    comments = [] if data_to_file is None else [f"{COMMENT} {json.dumps(asdict(data_to_file))}"]
    PlyData([PlyElement.describe(vertices, "vertex")], byte_order="<", comments=comments).write(file)
    return file.getvalue()


def stated_coordinates(path: Path) -> Canonical | None:
    """From the coordinates of the data's files to those of the file, by its comment; None: it does not say.

    DataError for a comment that is none of `ply_bytes`.
    """
    for words in _header(path):
        if words[:2] == [b"comment", COMMENT.encode()]:
            try:
                found = Canonical.from_dict(json.loads(b" ".join(words[2:])))
                numbers = np.array([*found.centre, found.scale, found.time_origin, found.time_scale], dtype=np.float64)
                if len(found.centre) == 3 and np.isfinite(numbers).all() and found.scale > 0 and found.time_scale > 0:
                    return found
            except (ValueError, TypeError, KeyError):
                pass
            raise DataError(path, f"a comment {COMMENT} with centre, scale, time_origin and time_scale", "another")
    return None


def load_ply(path: Path) -> Model:
    """Read a file of `save_ply` or of 3DGS. Raises DataError, a ValueError, naming the file and what is missing."""
    vertices = _vertices(path)
    present = set(vertices.dtype.names or ())
    kind = _kind(path, present)
    parameters = {
        field: torch.zeros(len(vertices), int(np.prod(row, initial=1))) for field, row in kind.shapes().items()
    }
    for name, field, index in _layout(kind):
        if name not in present:
            raise DataError(path, f"a property {name} of a {kind.motion} model", "none")
        parameters[field][:, index] = _column(vertices, name)
    parameters = {field: parameters[field].reshape(len(vertices), *row) for field, row in kind.shapes().items()}
    sphere = _column(vertices, "sphere") != 0 if "sphere" in present else None
    try:
        return Model(kind, parameters, sphere).checked()
    except ValueError as error:
        raise DataError(path, "the Gaussians of a model", str(error)) from None


def positions_of(path: Path) -> np.ndarray:
    """(N, 3) float64: x, y and z of a file that `load_ply` reads, which may have them in double precision."""
    vertices = _vertices(path)
    return np.stack([np.asarray(vertices[axis], np.float64) for axis in "xyz"], axis=1)


def _vertices(path: Path) -> np.ndarray:
    """The rows of the file's element `vertex`, at least one."""
    try:
        _check_header(path)
        vertices = PlyData.read(str(path))["vertex"].data
    except Exception as error:  # plyfile and numpy raise many types for broken files
        what = f"no element {error}" if isinstance(error, KeyError) else str(error)
        raise DataError(path, "a .ply file with vertices", what) from None
    if len(vertices) == 0:
        raise DataError(path, "at least one Gaussian", "none")
    return vertices


def _check_header(path: Path) -> None:
    """ValueError for a header that declares more data than the file holds, before plyfile allocates it; and for list
    properties, which a Gaussian never has and plyfile reads slowly."""
    elements: list[list[int]] = []  # rows, properties of each
    lines = _header(path)
    if lines[-1:] != [[b"end_header"]]:
        raise ValueError("no end_header")
    for word, *rest in lines:
        if word == b"element" and len(rest) == 2:
            elements.append([int(rest[1]), 0])
        elif word == b"property" and elements:
            if rest[:1] == [b"list"]:
                raise ValueError("a list property")
            elements[-1][1] += 1
    size = path.stat().st_size
    for rows, properties in elements:  # a value takes at least a byte
        if not 0 <= rows * max(1, properties) <= size:
            raise ValueError(f"a header that declares {rows} rows of {properties} values in {size} bytes")


def _header(path: Path) -> list[list[bytes]]:
    """The words of the header's lines, up to end_header if there is one."""
    found: list[list[bytes]] = []
    with open(path, "rb") as file:
        for line in itertools.islice(iter(lambda: file.readline(LONGEST_LINE), b""), LONGEST_HEADER):
            found += [words] if (words := line.split()) else []
            if words[:1] == [b"end_header"]:
                break
    return found


def _column(vertices: np.ndarray, name: str) -> torch.Tensor:
    with np.errstate(over="ignore"):  # a double too large for float32 becomes Inf, which is refused later
        return torch.from_numpy(np.array(vertices[name], dtype=np.float32))


def _kind(path: Path, present: set[str]) -> ModelKind:
    rest = sum(name.startswith("f_rest_") for name in present)
    degree = {0: 0, 9: 1, 24: 2, 45: 3}.get(rest)  # 3 ((l+1)² - 1)
    if degree is None:
        raise DataError(path, "0, 9, 24 or 45 properties f_rest_*", f"{rest}")
    fourier = sum(f"f_fourier{n}_0" in present for n in (1, 2))
    motion: Motion = "static" if "t" not in present else "full" if "rot_right_0" in present else "separable"
    return ModelKind(motion, fourier, degree)


def _layout(kind: ModelKind) -> list[tuple[str, str, int]]:
    """(property, field, flat index in the field's row), in the file's order.

    `sh` is stored as (coefficient, channel); 3DGS's f_rest is channel major: all of red, then green, then blue.
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
