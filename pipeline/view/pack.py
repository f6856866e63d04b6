"""A model as a viewer's data: 3D Gaussians that move on lines and fade, quantised, in order of place, compressed.

Conditioned on time a 4D Gaussian is a 3D one. With Σ = M Mᵀ as in docs/method.md 1.1, this is no approximation:

    mean at t        μ_xyz + velocity (t - μt),   velocity = Σ_xyz,t / Σtt
    covariance       A Aᵀ, constant in time       = R diag(scale²) Rᵀ
    opacity at t     opacity · exp(-½ (t - μt)²/Σtt), zero where the exponential is below 0.05

Shared trajectories (rasterizer/trajectories.py) displace and turn it besides. Of these the weights are quantised, and
the control points, which are few, stored in float32.

What is lost, at most, in units of the picture:

    position   POSITION_PX pixels at a depth of one normalised unit, over the whole time in which the Gaussian is seen
    scale      SCALE_STEP / 2 of itself;   lifetime: LIFETIME_STEP / 2
    rotation   ROTATION_STEP / 2 radians, and as much along shared trajectories
    opacity    LOGIT_STEP / 8 at most;     time: TIME_STEP of the shortest lifetimes, and of the duration
    colour     SH_STEP / 2 a coefficient, which makes a standard deviation of 0.003 of a Gaussian's colour

Each number is a whole number of steps, in as few bytes as its column needs. A column of C components is stored
component by component, each with its lowest byte first: all Gaussians' first bytes, then all their second ones.
Neighbours in space are neighbours in a column, so the higher bytes hardly change and the compression removes them.
"""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from datasets.scene import Scene
from pipeline.model.cube_map import CubeMap
from pipeline.model.environment_map import EnvironmentMap
from pipeline.model.model import Model
from rasterizer.gaussians import SH_LAYOUTS
from rasterizer.reference.blend import MIN_ALPHA, MIN_MARGINAL
from rasterizer.reference.render import slice_in_time
from rasterizer.trajectories import LEVELS, Trajectories

LIFETIME = math.sqrt(-2 * math.log(MIN_MARGINAL))  # half of it, in standard deviations: 2.45
POSITION_PX = 0.05
SCALE_STEP, LIFETIME_STEP, ROTATION_STEP = 0.01, 0.005, 0.002
LOGIT_STEP, SH_STEP = 0.02, 0.01
TIME_STEP = 0.01
ENVIRONMENT_STEP = 1 / 512
LOGITS = (-10.0, 10.0)  # beyond them neither the picture nor the kernel's alpha of at most 0.99 changes
LARGEST_SH = 2**15 - 1  # steps: a texture's 16-bit integer
MORTON_BITS = 10  # an axis

COMPRESSION = 3  # of zlib; 6 would take three times as long for 5 % less


@dataclass(frozen=True)
class Lines:
    """N Gaussians on lines; float64 arrays. In a static model velocity, mean_t and sigma_t are None."""

    mean: np.ndarray  # (N, 3) at the time mean_t
    scale: np.ndarray  # (N, 3) standard deviations along the axes of `rotation`
    rotation: np.ndarray  # (N, 3) axis × angle, radians
    opacity_logit: np.ndarray  # (N,)
    sh: np.ndarray  # (N, orders, coefficients, 3) float32
    velocity: np.ndarray | None  # (N, 3) units of length a unit of time
    mean_t: np.ndarray | None  # (N,)
    sigma_t: np.ndarray | None  # (N,)
    weights: np.ndarray | None = None  # (N, K) of the shared trajectories, which displace and turn them besides


def lines_of(model: Model) -> Lines:
    """The Gaussians of `model` that reach an alpha of 1/255 at some time; nothing else is ever drawn."""
    gaussians = model.gaussians()
    gaussians = gaussians.rows(gaussians.opacity_logit > math.log(MIN_ALPHA / (1 - MIN_ALPHA)))
    coefficients, orders = SH_LAYOUTS[gaussians.sh.shape[1]]
    sh = gaussians.sh.reshape(-1, orders, coefficients, 3).numpy()
    gaussians = gaussians.to(torch.float64)
    weights = None if gaussians.weights is None else gaussians.weights.numpy()
    sliced = slice_in_time(replace(gaussians, weights=None, trajectories=None), 0.0)
    mean, logit = gaussians.mean.numpy(), gaussians.opacity_logit.numpy()
    axes = _axes(sliced.factor.numpy())
    if sliced.variance_t is None:
        return Lines(mean, *axes, logit, sh, None, None, None)
    velocity, sigma_t = sliced.velocity.numpy(), sliced.variance_t.sqrt().numpy()
    return Lines(mean[:, :3], *axes, logit, sh, velocity, mean[:, 3], sigma_t, weights)


def _axes(factor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Scale (N, 3) and rotation (N, 3) of the covariances A Aᵀ, from A (N, 3, k)."""
    variance, directions = np.linalg.eigh(factor @ factor.transpose(0, 2, 1))
    directions[:, :, 0] *= np.sign(np.linalg.det(directions))[:, None]  # a rotation, not a reflection
    return np.sqrt(np.maximum(variance, 0)), Rotation.from_matrix(directions).as_rotvec()


@dataclass(frozen=True)
class Column:
    """How a column is stored. A stored number q of component c is the value (low[c] + q) · step."""

    name: str
    step: float
    low: tuple[int, ...]
    bytes: tuple[int, ...]  # of a number, by component; 0 where all are equal


Packing = tuple[Column, list[bytes]]  # a column and its planes of bytes


def quantised(name: str, values: np.ndarray, step: float) -> Packing:
    """Of `values` (N, …), of which a reader gets the nearest multiples of `step`."""
    rows = np.ascontiguousarray(values.reshape(len(values), math.prod(values.shape[1:])).T)
    counts = np.rint(rows / rows.dtype.type(step)).astype(np.int64 if rows.dtype == np.float64 else np.int32)
    low = counts.min(axis=1) if counts.size else np.zeros(len(counts), counts.dtype)
    above = (counts - low[:, None]).astype("<u4")
    sizes = tuple((int(largest).bit_length() + 7) // 8 for largest in above.max(axis=1, initial=0))
    digits = above.view(np.uint8).reshape(*above.shape, 4)
    planes = [digits[c, :, byte].tobytes() for c, size in enumerate(sizes) for byte in range(size)]
    return Column(name, step, tuple(low.tolist()), sizes), planes


@dataclass(frozen=True)
class Packed:
    header: dict  # count, kind, columns: what the page needs to read `data`
    data: bytes  # zlib


def pack(model: Model, scene: Scene, compression: int = COMPRESSION) -> Packed:
    """The Gaussians of `model` that are seen at a time of `scene`, and its environment map."""
    columns: list[Packing] = []
    lines = lines_of(model)
    length = POSITION_PX * scene.unit / max(max(view.camera.fx, view.camera.fy) for view in scene.train)
    shared: dict = {}
    if model.trajectories is not None and lines.weights is not None:
        shared["trajectories"], furthest = _shared(model.trajectories, length)
        lines = replace(lines, weights=lines.weights * furthest)
    seen = _columns_of(lines, scene, length, columns)
    header: dict = {
        "trained": len(model),
        "count": seen,
        "motion": model.kind.motion,
        "orders": model.kind.fourier_order + 1,
        "coefficients": (model.kind.sh_degree + 1) ** 2,
        "float32_bytes": model.bytes,
        **shared,
    }
    if (environment := model.environment_map) is not None:
        if isinstance(environment, CubeMap):  # the page knows one kind of map
            environment = environment.equirectangular(2 * environment.resolution)
        header["environment"] = _environment(environment, columns)
    header["columns"] = [asdict(column) for column, _ in columns]
    return Packed(header, zlib.compress(b"".join(plane for _, planes in columns for plane in planes), compression))


def _shared(trajectories: Trajectories, length: float) -> tuple[dict, np.ndarray]:
    """The trajectories for the page, each divided by how far it goes, and how far that is, (K,).

    Units are the errors allowed, `length` and ROTATION_STEP, whichever of them it goes further by. A level of B-splines
    goes no further than the furthest of its control points.
    """
    points = trajectories.control_points.double().numpy()
    ends = np.cumsum([intervals + 3 for intervals in LEVELS[len(points)]])[:-1]
    reached = sum(np.abs(level).max(axis=0) for level in np.split(points, ends)) / np.repeat([length, ROTATION_STEP], 3)
    furthest = np.maximum(reached.max(axis=1), np.finfo(np.float32).tiny)
    stored = base64.b64encode((points / furthest[:, None]).astype("<f4").tobytes()).decode()
    return {
        "count": len(trajectories),
        "span": trajectories.span,
        "levels": LEVELS[len(points)],
        "control_points": stored,
    }, furthest


def _columns_of(t: Lines, scene: Scene, length: float, columns: list[Packing]) -> int:
    """Appends the columns of the Gaussians that are seen; returns how many there are. length: largest error of a place.

    Stored is the part of a Gaussian's line where it is seen: its middle, and how far it is from there to its end. The
    error of a place is then the same at all times. Where there are trajectories, half of it is that of the K weights,
    each of which is rounded by 1/(2K).
    """
    step_xyz = length if t.weights is None else length / 2  # two numbers are rounded by half of it
    if t.velocity is None or t.mean_t is None or t.sigma_t is None:
        rows = _by_place(t.mean)
        columns.append(quantised("middle", t.mean[rows], step_xyz))
    else:
        shortest = np.quantile(t.sigma_t, 0.01) if len(t.sigma_t) else 0.0
        step = max(TIME_STEP * min(float(shortest), scene.duration), scene.duration * 2.0**-23)
        sigma = np.exp(np.rint(np.log(t.sigma_t) / LIFETIME_STEP) * LIFETIME_STEP)
        mean_t = np.rint(t.mean_t / step) * step
        first, last = seen_from_to(mean_t, sigma, scene.time_start, scene.time_end)
        half = 0.5 * (last - first)
        middle = t.mean + t.velocity * (0.5 * (first + last) - t.mean_t)[:, None]
        rows = np.flatnonzero(half >= 0)
        rows = rows[_by_place(middle[rows])]
        columns.append(quantised("mean_t", t.mean_t[rows], step))
        columns.append(quantised("log_sigma_t", np.log(t.sigma_t)[rows], LIFETIME_STEP))
        columns.append(quantised("middle", middle[rows], step_xyz))
        columns.append(quantised("reach", (t.velocity * half[:, None])[rows], step_xyz))
    if t.weights is not None:
        columns.append(quantised("weights", t.weights[rows], 1 / t.weights.shape[1]))
    columns.append(quantised("log_scale", np.log(np.maximum(t.scale[rows], 0.1 * length)), SCALE_STEP))
    columns.append(quantised("rotation", t.rotation[rows], ROTATION_STEP))
    columns.append(quantised("opacity_logit", np.clip(t.opacity_logit[rows], *LOGITS), LOGIT_STEP))
    columns.append(quantised("sh", np.clip(t.sh[rows], -LARGEST_SH * SH_STEP, LARGEST_SH * SH_STEP), SH_STEP))
    return len(rows)


def seen_from_to(mean_t: np.ndarray, sigma_t: np.ndarray, start: float, end: float) -> tuple[np.ndarray, np.ndarray]:
    """When each Gaussian has p(t) >= 0.05, within [start, end]; the first time is after the last where it never has."""
    return np.maximum(start, mean_t - LIFETIME * sigma_t), np.minimum(end, mean_t + LIFETIME * sigma_t)


def _by_place(points: np.ndarray) -> np.ndarray:
    """Rows (N,) in Morton order of `points` (N, 3)."""
    if len(points) == 0:
        return np.zeros(0, np.int64)
    low, high = np.quantile(points, 0.01, axis=0), np.quantile(points, 0.99, axis=0)
    cells = (points - low) / np.maximum(high - low, np.finfo(np.float32).tiny) * 2**MORTON_BITS
    cells = np.clip(cells, 0, 2**MORTON_BITS - 1).astype(np.int64)
    key = np.zeros(len(points), np.int64)
    for bit in range(MORTON_BITS):
        for axis in range(3):
            key |= (cells[:, axis] >> bit & 1) << (3 * bit + axis)
    return np.argsort(key, kind="stable")


def _environment(environment: EnvironmentMap, columns: list[Packing]) -> Sequence[int]:
    """Appends the map as a column of a row a texel; returns its (height, width)."""
    image = environment.image.numpy()
    columns.append(quantised("environment", np.clip(image, -8, 8).reshape(3, -1).T, ENVIRONMENT_STEP))
    return image.shape[1:]
