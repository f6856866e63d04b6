"""Readers of the exported formats, written from their descriptions; independent of the writers in pipeline/export."""

from __future__ import annotations

import gzip
import io
import json
import struct
from dataclasses import replace

import fourdgs
import numpy as np
import torch
from plyfile import PlyData

from pipeline.export.source import Timeline
from pipeline.export.splats import MovingGaussians
from pipeline.model.model import Model, ModelKind
from rasterizer.reference.blend import MIN_ALPHA, MIN_MARGINAL

C0 = 0.28209479177387814
RUB = np.diag([1.0, -1.0, -1.0])  # right, up, back of right, down, forward


def static(mean, scale, quat, alpha, sh) -> Model:
    """scale: standard deviations; alpha: opacities; sh: (N, K, 3)."""
    alpha = np.clip(np.asarray(alpha, np.float64), 1e-6, 1 - 1e-6)
    fields = {
        "mean": mean,
        "log_scale": np.log(np.asarray(scale, np.float64)),
        "quat_left": quat,
        "opacity_logit": np.log(alpha / (1 - alpha)),
        "sh": sh,
    }
    tensors = {name: torch.from_numpy(np.asarray(value, np.float32).copy()) for name, value in fields.items()}
    return Model(ModelKind("static", 0, round(tensors["sh"].shape[1] ** 0.5) - 1), tensors)


def static_at(moving: MovingGaussians, time: float) -> Model:
    """The static model at `time`, without what cannot be seen then."""
    elapsed = time - moving.time
    marginal = torch.exp(-0.5 * (elapsed / moving.sigma) ** 2)
    alpha = moving.opacity * marginal
    seen = (marginal >= MIN_MARGINAL) & (alpha >= MIN_ALPHA)
    if moving.window is not None:
        seen &= (moving.window[:, 0] <= time) & (time < moving.window[:, 1])
    mean = moving.mean + moving.velocity * elapsed[:, None]
    return static(*(tensor[seen] for tensor in (mean, moving.log_scale.exp(), moving.quat, alpha, moving.sh)))


def read_ply(content: bytes) -> Model:
    rows = PlyData.read(io.BytesIO(content))["vertex"].data
    rest = sum(name.startswith("f_rest_") for name in rows.dtype.names) // 3

    def columns(*names: str) -> np.ndarray:
        return np.stack([rows[name] for name in names], axis=1)

    dc = columns("f_dc_0", "f_dc_1", "f_dc_2")[:, None]
    others = [columns(*(f"f_rest_{c * rest + k}" for c in range(3))) for k in range(rest)]
    alpha = 1 / (1 + np.exp(-rows["opacity"].astype(np.float64)))
    scale = np.exp(columns("scale_0", "scale_1", "scale_2").astype(np.float64))
    sh = np.concatenate([dc, *(coefficient[:, None] for coefficient in others)], axis=1)
    return static(columns("x", "y", "z"), scale, columns("rot_0", "rot_1", "rot_2", "rot_3"), alpha, sh)


def read_splat(content: bytes) -> Model:
    rows = np.frombuffer(content, np.uint8).reshape(-1, 32)
    floats = rows[:, :24].copy().view("<f4")
    rgba, quat = rows[:, 24:28] / 255.0, rows[:, 28:32] / 128.0 - 1.0
    return static(floats[:, :3], floats[:, 3:], quat, rgba[:, 3], ((rgba[:, :3] - 0.5) / C0)[:, None])


def read_spz(content: bytes) -> Model:
    data = gzip.decompress(content)
    magic, version, count, degree, bits, flags, _ = struct.unpack("<IIIBBBB", data[:16])
    assert (magic, version, flags) == (0x5053474E, 3, 0)
    coefficients = (degree + 1) ** 2 - 1
    at, planes = 16, []
    for width in (9, 1, 3, 3, 4, 3 * coefficients):
        planes.append(np.frombuffer(data, np.uint8, count * width, at).reshape(count, width).astype(np.int64))
        at += count * width
    assert at == len(data)
    position, alpha, colour, scale, rotation, sh = planes
    fixed = (position.reshape(count, 3, 3) * [1, 256, 65536]).sum(axis=2)
    mean = np.where(fixed >= 2**23, fixed - 2**24, fixed) / 2**bits
    word = (rotation * [1, 2**8, 2**16, 2**24]).sum(axis=1)
    quat = np.zeros((count, 4))  # xyzw
    for row in range(count):
        largest, rest = int(word[row] >> 30), int(word[row])
        for axis in (3, 2, 1, 0):
            if axis != largest:
                magnitude = (rest & 511) / 511 / np.sqrt(2)
                quat[row, axis] = -magnitude if rest >> 9 & 1 else magnitude
                rest >>= 10
        quat[row, largest] = np.sqrt(1 - (quat[row] ** 2).sum())
    dc = (colour / 255 - 0.5) / 0.15
    sh = (sh.reshape(count, coefficients, 3) - 128) / 128
    model = static(
        mean, np.exp(scale / 16 - 10), np.roll(quat, 1, axis=1), alpha[:, 0] / 255, np.concatenate([dc[:, None], sh], 1)
    )
    return in_axes(model, RUB)


def read_glb(content: bytes) -> Model:
    magic, version, length = struct.unpack("<4sII", content[:12])
    assert (magic, version, length) == (b"glTF", 2, len(content))
    text_length, kind = struct.unpack("<I4s", content[12:20])
    document, binary = json.loads(content[20 : 20 + text_length]), content[28 + text_length :]
    assert kind == b"JSON" and document["buffers"][0]["byteLength"] == len(binary)
    primitive = document["meshes"][0]["primitives"][0]
    assert primitive["mode"] == 0 and primitive["extensions"]["KHR_gaussian_splatting"]["kernel"] == "ellipse"

    def attribute(name: str) -> np.ndarray:
        accessor = document["accessors"][primitive["attributes"][name]]
        view = document["bufferViews"][accessor["bufferView"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        assert view["byteOffset"] % 4 == 0 and accessor["componentType"] == 5126
        values = np.frombuffer(binary, "<f4", accessor["count"] * width, view["byteOffset"])
        return values.reshape(-1, width)

    names = [f"SH_DEGREE_{degree}_COEF_{i}" for degree in range(4) for i in range(2 * degree + 1)]
    stored = [f"KHR_gaussian_splatting:{name}" for name in names]
    sh = [attribute(name) for name in stored if name in primitive["attributes"]]
    model = static(
        attribute("POSITION"),
        attribute("KHR_gaussian_splatting:SCALE"),
        np.roll(attribute("KHR_gaussian_splatting:ROTATION"), 1, axis=1),
        attribute("KHR_gaussian_splatting:OPACITY")[:, 0],
        np.stack(sh, axis=1),
    )
    return in_axes(model, RUB)


def in_axes(model: Model, axes: np.ndarray) -> Model:
    """A static model with its world rotated by `axes`; SH by projection of the rotated functions (least squares)."""
    from scipy.spatial.transform import Rotation

    from rasterizer.reference.sh import sh_basis

    p = dict(model.parameters)
    directions = torch.nn.functional.normalize(torch.randn(64, 3, generator=torch.Generator().manual_seed(0)).double())
    there, here = (sh_basis(d, model.kind.sh_degree) for d in (directions, directions @ torch.from_numpy(axes)))
    change = torch.linalg.lstsq(there, here).solution  # columns: Y_k(axesᵀ d) in terms of Y(d)
    turn = Rotation.from_matrix(axes)
    xyzw = np.roll(p["quat_left"].numpy(), -1, axis=1)
    p["mean"] = torch.from_numpy((p["mean"].double().numpy() @ axes.T).astype(np.float32))
    quat = np.roll((turn * Rotation.from_quat(xyzw)).as_quat(), 1, axis=1)
    p["quat_left"] = torch.from_numpy(quat.astype(np.float32))
    p["sh"] = torch.einsum("jk,nkc->njc", change, p["sh"].double()).float()
    return Model(model.kind, p)


def read_ftgs(content: bytes) -> MovingGaussians:
    """Times are normalised."""
    file = PlyData.read(io.BytesIO(content))
    rows = file["vertex"].data
    settings = dict(comment.split() for comment in file.comments)
    assert settings["ftgs_version"] == "1" and settings["time_units"] == "normalized"
    assert settings["use_velocity"] == "1" and settings["opacity_floor"] == "0"

    def columns(*names: str) -> torch.Tensor:
        return torch.from_numpy(np.stack([rows[name].astype(np.float64) for name in names], axis=1))

    coefficients = (int(settings["sh_degree"]) + 1) ** 2 - 1
    rest = columns("f_dc_0", *(f"f_rest_{i}" for i in range(3 * coefficients)))[:, 1:]
    sh = torch.cat(
        [columns("f_dc_0", "f_dc_1", "f_dc_2")[:, None], rest.unflatten(1, (3, coefficients)).transpose(1, 2)], dim=1
    )
    sigma = columns("log_duration")[:, 0].exp()
    assert sigma.min() >= float(settings["min_duration"]) * (1 - 1e-4)
    return MovingGaussians(
        columns("x", "y", "z"),
        columns("velocity_0", "velocity_1", "velocity_2"),
        columns("scale_0", "scale_1", "scale_2"),
        columns("rot_0", "rot_1", "rot_2", "rot_3"),
        torch.sigmoid(columns("opacity")[:, 0]),
        sh,
        columns("time")[:, 0],
        sigma,
    )


def read_splatv(content: bytes) -> MovingGaussians:
    """Times are normalised."""
    magic, length = struct.unpack("<II", content[:8])
    (chunk,) = json.loads(content[8 : 8 + length])
    texels = content[8 + length :]
    assert magic == 0x674B and chunk["type"] == "splat"
    assert len(texels) == chunk["size"] == chunk["texwidth"] * chunk["texheight"] * 16
    rows = np.frombuffer(texels, np.uint8).reshape(-1, 64)
    rows = rows[rows[:, 31] > 0]  # alpha 0: the rest of the texture
    half = rows[:, 12:].copy().view("<f2").astype(np.float64)
    rgba = rows[:, 28:32] / 255.0
    assert not half[:, 13:19].any() and not half[:, 20:24].any(), "no motion but on lines"
    fields = (
        rows[:, :12].copy().view("<f4").astype(np.float64),
        half[:, 10:13],
        np.log(half[:, 4:7]),
        half[:, :4],
        rgba[:, 3],
        ((rgba[:, :3] - 0.5) / C0)[:, None],
        half[:, 24],
        half[:, 25] / np.sqrt(2),
    )
    return MovingGaussians(*(torch.from_numpy(np.ascontiguousarray(field)) for field in fields))


def read_fourdgs(content: bytes, seconds: float) -> MovingGaussians:
    """By the format's own library; times are normalised."""
    g = fourdgs.read(content).gaussians
    assert g.sh is not None
    sh = (g.sh / 255.0 * 8 - 4).reshape(g.count, 3, -1).transpose(0, 2, 1)
    dc = (g.colors[:, :3] - 0.5) / C0
    fields = (
        g.positions,
        g.motions * seconds,
        np.log(g.scales),
        np.roll(g.rotations, 1, axis=1),
        g.colors[:, 3],
        np.concatenate([dc[:, None], sh], axis=1),
        g.mu_t / seconds,
        g.sigma_t / seconds,
        np.stack([g.win_lo, g.win_hi], axis=1) / seconds,
    )
    return MovingGaussians(*(torch.from_numpy(np.array(field, np.float64)) for field in fields))


def in_time(moving: MovingGaussians, line: Timeline) -> MovingGaussians:
    """From normalised times to those of the scene."""
    return replace(
        moving,
        velocity=moving.velocity / line.duration,
        time=line.start + moving.time * line.duration,
        sigma=moving.sigma * line.duration,
        window=None if moving.window is None else line.start + moving.window * line.duration,
    )
