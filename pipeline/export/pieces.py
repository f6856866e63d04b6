"""Gaussians on shared trajectories, for formats of Gaussians that move on lines: cut into pieces in time.

A Gaussian becomes n = 1, 2, 4 … pieces of h = T/n. A piece about the time c moves on the line through the path at
c ± ρ/√2, which has half the error of a chord, and is turned as at c. n is the least with which neither the mean nor an
end of the largest axis is off by more than TOLERANCE pixels from c - ρ to c + ρ.

With windows a piece is seen for just its h: ρ = h/2. Else its opacity has the factor exp(-½ ((t - c)/s)²), s = 0.45 h,
which is a half at ρ = 0.53 h. The factors sum to 1.13 ± 0.04 at every time. Where two pieces meet, a Gaussian of
opacity 0.99 has 0.78; what overlaps it hides most of that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from pipeline.export.source import Timeline
from pipeline.export.splats import (
    REACH,
    MovingGaussians,
    constant_colour,
    mean_fourier_basis,
    moving_gaussians,
    scales_and_rotation,
)
from pipeline.export.temporal_formats import camera_before
from pipeline.model.model import Model
from rasterizer.gaussians import Gaussians
from rasterizer.reference.blend import MIN_ALPHA, MIN_MARGINAL
from rasterizer.reference.render import opacity, quaternion_product, slice_in_time, turning, world_to_camera
from rasterizer.trajectories import LEVELS, Trajectories

TOLERANCE = 0.5  # pixels
MAX_PIECES, MAX_ROWS = 64, 2_000_000  # of a Gaussian; of all
OVERLAP = 0.45  # s/h
HALF = math.sqrt(2 * math.log(2))  # ρ/s
SAMPLES = 4  # times for each interval of the splines at which errors are measured; of a piece at least twice as many


def film_of(model: Model, line: Timeline, windows: bool) -> MovingGaussians:
    """The Gaussians of a model with time, as such that move on lines. windows: whether the format has windows in time.

    The note states the largest errors. ValueError for a static model.
    """
    if model.trajectories is None:
        return moving_gaussians(model, line.start, line.duration)
    paths = Paths.of(model.gaussians().to(torch.float64))
    pixel = pixel_size(paths.at(line.start + 0.5 * line.duration)[0], line)
    found: list[MovingGaussians] = []
    largest, n, rows = torch.zeros(2, dtype=torch.float64), 1, 0
    while len(paths.mean):
        window = windows or n == 1
        pieces = [Piece(paths, line, n, k, window) for k in (range(n) if window else range(-1, n + 1))]
        errors = torch.stack([piece.errors() for piece in pieces]).amax(dim=0)  # (2, N)
        done = (errors <= TOLERANCE * pixel).all(dim=0)
        if n == MAX_PIECES or rows + 2 * n * int((~done).sum()) > MAX_ROWS:
            done[:] = True
        largest = torch.cat([largest[:, None], errors[:, done]], dim=1).amax(dim=1)
        found += [piece.moving(done, model) for piece in pieces]
        paths, n, rows = paths.rows(~done), 2 * n, sum(map(len, found))
    position, turn = largest.tolist()
    note = (
        f"{len(model):,} Gaussians on shared trajectories became {rows:,} that move on lines for a part of the time, "
        f"off by at most {position / pixel:.2f} px ({position:.2g}), by turning {turn / pixel:.2f} px at an axis' end"
    )
    names = [f.name for f in fields(MovingGaussians) if f.name != "note"]
    columns = {name: torch.cat([getattr(piece, name) for piece in found]) for name in names}
    return MovingGaussians(**columns, note=note)


def pixel_size(mean: Tensor, line: Timeline) -> float:
    """World units at the median depth of means (N, 3), for the camera that the player begins with."""
    camera = line.camera or camera_before(mean)
    depth = world_to_camera(mean, camera)[:, 2]
    return float(depth[depth > 0].median()) / camera.fx if (depth > 0).any() else math.inf


@dataclass(frozen=True)
class Paths:
    """N Gaussians and where they are at any time, float64."""

    gaussians: Gaussians
    mean: Tensor  # (N, 3) at time 0, without the trajectories
    velocity: Tensor  # (N, 3) likewise
    sigma: Tensor  # (N,) √Σtt
    log_scale: Tensor  # (N, 3)
    quat: Tensor  # (N, 4) without the trajectories

    @classmethod
    def of(cls, gaussians: Gaussians) -> Paths:
        sliced = slice_in_time(replace(gaussians, weights=None, trajectories=None), 0.0)
        assert sliced.variance_t is not None
        shape = scales_and_rotation(sliced.factor)
        return cls(gaussians, sliced.mean, sliced.velocity, sliced.variance_t.sqrt(), *shape)

    def rows(self, chosen: Tensor) -> Paths:
        tensors = (self.mean, self.velocity, self.sigma, self.log_scale, self.quat)
        return Paths(self.gaussians.rows(chosen), *(tensor[chosen] for tensor in tensors))

    @property
    def trajectories(self) -> Trajectories:
        assert self.gaussians.trajectories is not None
        return self.gaussians.trajectories

    def at(self, time: float) -> tuple[Tensor, Tensor]:
        """Means (N, 3), and rotation vectors (N, 3) of the turn by the trajectories."""
        assert self.gaussians.weights is not None
        displacement, turn = (self.gaussians.weights @ self.trajectories.values(time)).split(3, dim=1)
        return self.mean + self.velocity * time + displacement, turn


@dataclass(frozen=True)
class Piece:
    """Piece `number` of `n` of each of N Gaussians. Without windows there are -1 and n for the ends of the scene's
    time."""

    paths: Paths
    line: Timeline
    n: int
    number: int
    window: bool

    @property
    def middle(self) -> float:
        return self.line.start + self.line.duration * (self.number + 0.5) / self.n

    @property
    def reach(self) -> float:
        """ρ"""
        return self.line.duration / self.n * (0.5 if self.window else HALF * OVERLAP)

    @property
    def seen(self) -> tuple[float, float]:
        """c - ρ and c + ρ, in the scene's time."""
        return max(self.middle - self.reach, self.line.start), min(self.middle + self.reach, self.line.end)

    def path(self) -> tuple[Tensor, Tensor, Tensor]:
        """Mean at the middle, velocity, and the turn: (N, 3) each."""
        step = self.reach / math.sqrt(2)
        before, after = (self.paths.at(self.middle + off)[0] for off in (-step, step))
        return 0.5 * (before + after), (after - before) / (2 * step), self.paths.at(self.middle)[1]

    def errors(self) -> Tensor:
        """(2, N) world units: how far, at most, the mean is from where it should be, and an end of the largest axis by
        its turn, while the Gaussian is seen."""
        first, last = self.seen
        axis, mu_t = self.paths.log_scale.amax(dim=1).exp(), self.paths.gaussians.mean[:, 3]
        largest = torch.zeros(2, len(axis), dtype=torch.float64)
        mean, velocity, turn = self.path()
        intervals = LEVELS[len(self.paths.trajectories.control_points)][-1]
        for time in torch.linspace(
            first, last, max(2, intervals // self.n) * SAMPLES + 1, dtype=torch.float64
        ).tolist():
            here, turned = self.paths.at(time)
            off = here - mean - velocity * (time - self.middle), axis[:, None] * (turned - turn)
            alive = (time - mu_t).abs() <= REACH * self.paths.sigma
            largest = torch.maximum(largest, torch.stack([vector.norm(dim=1) * alive for vector in off]))
        return largest

    def moving(self, chosen: Tensor, model: Model) -> MovingGaussians:
        """Those of `chosen`, (N,) bool, that are seen."""
        first, last = self.seen
        g, own = self.paths.gaussians, self.paths.sigma
        time, sigma, alpha = g.mean[:, 3], own, opacity(g.opacity_logit)
        if not self.window:  # of a product of two Gaussians in time
            width = OVERLAP * self.line.duration / self.n
            off = time - self.middle
            alpha = alpha * torch.exp(-0.5 * off**2 / (own**2 + width**2))
            time, sigma = self.middle + off / (1 + (own / width) ** 2), own / torch.sqrt(1 + (own / width) ** 2)
        marginal = torch.exp(-0.5 * ((g.mean[:, 3].clamp(first, last) - g.mean[:, 3]) / own) ** 2)
        highest = alpha * torch.exp(-0.5 * ((time.clamp(first, last) - time) / sigma) ** 2)
        rows = chosen & (marginal >= MIN_MARGINAL) & (highest >= MIN_ALPHA)
        time, sigma = time[rows], sigma[rows]
        mean, velocity, turn = (part[rows] for part in self.path())
        span = torch.tensor([-math.inf, math.inf], dtype=torch.float64)
        if self.window:
            ends = [self.line.start + self.line.duration * k / self.n for k in (self.number, self.number + 1)]
            span = torch.tensor([ends[0], ends[1] if self.number + 1 < self.n else math.inf], dtype=torch.float64)
        basis = mean_fourier_basis(
            time, sigma, first, last, self.line.duration, model.kind.fourier_order, g.mean[rows, 3]
        )
        return MovingGaussians(
            mean + velocity * (time - self.middle)[:, None],
            velocity,
            self.paths.log_scale[rows],
            quaternion_product(turning(turn), self.paths.quat[rows]),
            alpha[rows],
            constant_colour(model, g.sh[rows], basis),
            time,
            sigma,
            span.expand(len(time), 2),
        )
