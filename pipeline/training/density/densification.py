"""Adaptive density control in space and time (docs/method.md 2): cloning, splitting, pruning and opacity resets.

Gaussians with large positional gradients are where the model is too coarse: small ones are cloned, large ones split.
There are two indicators: the gradient of the projected mean and the gradient of the mean in time. All functions are
pure except `densify` and `reset_opacity`, which apply the decisions through the optimiser. Gaussians on the sphere
around the scene follow the rules in model/sphere.py.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from pipeline.config.train_schema import DensifyConfig
from pipeline.model.model import Model
from pipeline.training.density.statistics import Statistics
from pipeline.training.optimiser import Adam
from pipeline.training.schedule import Phase
from pipeline.training.state import TrainState
from rasterizer.covariance import scaled_axes

TIME_GRADIENT = 1e-4  # ours: threshold of the temporal indicator |∂L/∂μt|, time in units of the duration
# The rest are the values of 3DGS's program.
SPLIT_SCALE = 0.01  # × extent: Gaussians up to this scale are cloned, larger ones split
SPLIT_COUNT = 2  # children of a split
SPLIT_SHRINK = 1.6  # the children's scales are divided by this
PRUNE_OPACITY = 0.005  # Gaussians of lower opacity are pruned
# Largest spatial scale; × extent. 3DGS's paper also prunes by the radius on the screen. Its program never does: it
# clears the radii before it compares them (https://github.com/graphdeco-inria/gaussian-splatting/issues/123).
PRUNE_SCALE = 0.1
RESET_OPACITY = 0.01  # highest opacity after a reset


@dataclass(frozen=True)
class Growth:
    """The selection of one densification; (N,) bool masks."""

    clone: Tensor
    split: Tensor  # disjoint from clone
    by_time: Tensor  # selected by the temporal indicator


@dataclass(frozen=True)
class Densified:
    """Counts of one densification, in Gaussians."""

    cloned: int
    split: int
    pruned: int


@dataclass(frozen=True)
class Densification:
    """Cloning, splitting and pruning, every `train.densify.every` iterations."""

    rules: DensifyConfig
    extent: float  # of the scene, world units
    time_split: bool  # whether splits sample time, too
    event = "densify"

    def due(self, iteration: int, clock: float) -> bool:
        return self.rules.start < iteration and clock < self.rules.stop and iteration % self.rules.every == 0

    def apply(self, state: TrainState, phase: Phase) -> dict[str, int]:
        done = densify(
            state.optimiser, state.statistics, phase.clock, self.rules, self.extent,
            self.time_split, state.split_rng, phase.sphere,
        )  # fmt: skip
        state.reset_statistics()
        return asdict(done)


@dataclass(frozen=True)
class OpacityReset:
    rules: DensifyConfig
    event = "reset_opacity"

    def due(self, iteration: int, clock: float) -> bool:
        every = self.rules.opacity_reset_every
        return every > 0 and clock < self.rules.stop and iteration % every == 0

    def apply(self, state: TrainState, phase: Phase) -> dict[str, int]:
        reset_opacity(state.optimiser, phase.sphere)
        return {}


def choose_growth(model: Model, statistics: Statistics, cfg: DensifyConfig, extent: float, time_split: bool) -> Growth:
    """Select the Gaussians to clone and to split.

    A Gaussian is selected if one of its indicators reaches its threshold; the temporal one is used only with
    `use_time_gradient` and `time_split`. Gaussians transparent enough to be pruned are not selected. At the cap
    `max_gaussians`, the highest priority, the ratio of indicator to threshold, is selected first, ties by index. The
    sphere's Gaussians are neither selected nor counted. extent: world units.
    """
    space, time = statistics.indicators()
    priority, by_time = space / cfg.space_gradient, torch.zeros_like(space, dtype=torch.bool)
    if cfg.use_time_gradient and time_split and model.kind.dims == 4:
        by_time = time >= TIME_GRADIENT
        priority = torch.maximum(priority, time / TIME_GRADIENT)
    transparent = _transparent(model)
    others = torch.ones_like(transparent) if model.sphere is None else ~model.sphere
    selected = (priority >= 1) & others & ~transparent
    large = _spatial_scale(model) > SPLIT_SCALE * extent
    added = torch.where(large, SPLIT_COUNT - 1, 1)  # a split replaces its parent

    room = cfg.max_gaussians - int((others & ~transparent).sum())
    if int(added[selected].sum()) > room:
        order = torch.sort(priority.masked_fill(~selected, -1.0), descending=True, stable=True).indices
        order = order[: int(selected.sum())]
        selected = torch.zeros_like(selected)
        selected[order[torch.cumsum(added[order], 0) <= room]] = True
    return Growth(clone=selected & ~large, split=selected & large, by_time=by_time)


def split_rows(model: Model, mask: Tensor, time_split: bool, rng: torch.Generator) -> dict[str, Tensor]:
    """The SPLIT_COUNT children of each Gaussian in `mask`, as (count · SPLIT_COUNT, …) rows: all first children, then
    all second ones.

    With `time_split`, means are sampled from the 4D Gaussian N(μ, R diag(s)² Rᵀ), space and time jointly, and all
    scales shrink. Without it, μt and st are kept, the spatial scales shrink, and positions are sampled from the
    conditional N(μ_xyz, Σ(μt)), not from the spatial marginal, which is extended along the motion.
    """
    rows = {name: p[mask].repeat(SPLIT_COUNT, *([1] * (p.dim() - 1))) for name, p in model.parameters.items()}
    dims = model.kind.dims
    noise = torch.randn(len(rows["mean"]), dims, generator=rng).to(model.device)
    axes = scaled_axes(model.gaussians().rows(mask.nonzero()[:, 0].repeat(SPLIT_COUNT)))  # M, (n, dims, dims)
    if dims == 3 or time_split:
        rows["mean"] = rows["mean"] + (axes @ noise[:, :, None])[:, :, 0]
        shrunk = dims
    else:
        time_row = F.normalize(axes[:, 3], dim=1)  # v of docs/method.md 1.1
        noise = noise - time_row * (time_row * noise).sum(dim=1, keepdim=True)  # (I - v vᵀ) ε
        rows["mean"][:, :3] += (axes[:, :3] @ noise[:, :, None])[:, :, 0]
        shrunk = 3
    rows["log_scale"][:, :shrunk] -= torch.log(torch.tensor(SPLIT_SHRINK))
    return rows


def halved_opacity(logit: Tensor) -> Tensor:
    """The logit of 1 - √(1 - α): two Gaussians of this opacity in one place let as much light through as one of α does,
    at their centre.

    Without it each clone makes its surroundings more opaque (Bulò, Porzi & Kontschieder, ECCV 2024).
    """
    # With β = 1 - α: logit = log((1 - √β) / √β); √β = exp(½ log β) without cancellation for any α.
    half_log = 0.5 * F.logsigmoid(-logit)
    return torch.log(-torch.expm1(half_log)) - half_log


def to_prune(model: Model, clock: float, cfg: DensifyConfig, extent: float, train_sphere: bool = True) -> Tensor:
    """(N,) bool: too transparent, or, after the first opacity reset, too large in space.

    clock: position in the schedule (schedule.py).
    """
    transparent = _transparent(model)
    prune = transparent
    if clock > cfg.opacity_reset_every > 0:
        prune = prune | (_spatial_scale(model) > PRUNE_SCALE * extent)
    if model.sphere is not None:
        prune = torch.where(model.sphere, transparent & train_sphere, prune)
    return prune


def densify(
    optimiser: Adam,
    statistics: Statistics,
    clock: float,
    cfg: DensifyConfig,
    extent: float,
    time_split: bool,
    rng: torch.Generator,
    train_sphere: bool = True,  # False: the sphere is frozen
) -> Densified:
    """Clone, split, then prune the optimiser's model. `statistics` are invalid afterwards.

    New order: unsplit Gaussians, clones, children of splits.
    """
    model = optimiser.model
    growth = choose_growth(model, statistics, cfg, extent, time_split)
    if cfg.correct_clones:
        logit = model.parameters["opacity_logit"]
        logit[growth.clone] = halved_opacity(logit[growth.clone])
    clones = {name: p[growth.clone] for name, p in model.parameters.items()}
    if cfg.split_by_cause:
        parts = [
            split_rows(model, growth.split & growth.by_time, time_split, rng),
            split_rows(model, growth.split & ~growth.by_time, False, rng),
        ]
        children = {name: torch.cat([part[name] for part in parts]) for name in clones}
    else:
        children = split_rows(model, growth.split, time_split, rng)
    optimiser.keep(~growth.split)
    optimiser.append({name: torch.cat([clones[name], children[name]]) for name in clones})

    pruned = remove(optimiser, to_prune(model, clock, cfg, extent, train_sphere))
    return Densified(int(growth.clone.sum()), int(growth.split.sum()), pruned)


def remove(optimiser: Adam, chosen: Tensor) -> int:
    """Remove the Gaussians `chosen`, (N,) bool, and return how many; none if only the sphere around the scene would be
    left, because an empty model cannot recover."""
    sphere = optimiser.model.sphere
    kept = ~chosen if sphere is None else ~chosen & ~sphere
    if not chosen.any() or not kept.any():
        return 0
    optimiser.keep(~chosen)
    return int(chosen.sum())


def reset_opacity(optimiser: Adam, train_sphere: bool = True) -> None:
    """Clamp every opacity to at most RESET_OPACITY and zero its moments, as 3DGS; a frozen sphere is unchanged."""
    highest = torch.logit(torch.tensor(RESET_OPACITY, dtype=torch.float64)).item()
    sphere, logit = optimiser.model.sphere, optimiser.model.parameters["opacity_logit"]
    rows = slice(None) if sphere is None or train_sphere else ~sphere
    logit[rows] = logit[rows].clamp(max=highest)
    optimiser.zero_moments("opacity_logit", rows)


def _transparent(model: Model) -> Tensor:
    return torch.sigmoid(model.parameters["opacity_logit"]) < PRUNE_OPACITY


def _spatial_scale(model: Model) -> Tensor:
    """(N,) the largest spatial scale, world units."""
    return model.parameters["log_scale"][:, :3].amax(dim=1).exp()
