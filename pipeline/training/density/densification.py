"""Adaptive density control in space and time (docs/method.md 2): who is cloned, split or removed, and when.

Gaussians whose place the loss keeps pulling at stand where the model is too coarse: a small one is cloned, a big one
split. Two indicators say so, the gradient of the position on the screen and the gradient of the mean in time. The
functions here are pure but for `densify` and `reset_opacity`, which apply their decisions through the optimiser.
Gaussians on the sphere round the scene have rules of their own, see sphere.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pipeline.config.train_schema import DensifyConfig
from pipeline.model.model import Model
from pipeline.training.density.statistics import Statistics
from pipeline.training.optimiser import Adam
from rasterizer import Gaussians
from rasterizer.covariance import scaled_axes


@dataclass(frozen=True)
class Growth:
    """Decisions of one densification; (N,) bool masks."""

    clone: Tensor
    split: Tensor  # disjoint from clone
    in_time: Tensor  # those whose temporal indicator selected them


@dataclass(frozen=True)
class Densified:
    """What one densification did; counts of Gaussians."""

    cloned: int
    split: int
    pruned: int
    total: int


def due(iteration: int, now: float, cfg: DensifyConfig) -> bool:
    """Is there a densification after `iteration`? `now`: the schedule's clock, which ends the phase."""
    return cfg.start < iteration and now < cfg.stop and iteration % cfg.every == 0


def opacity_reset_due(iteration: int, now: float, cfg: DensifyConfig) -> bool:
    return cfg.opacity_reset_every > 0 and now < cfg.stop and iteration % cfg.opacity_reset_every == 0


def choose_growth(model: Model, statistics: Statistics, cfg: DensifyConfig, extent: float, time_split: bool) -> Growth:
    """Who is cloned and who is split.

    Either indicator at its threshold selects; the temporal one only with `use_time_gradient` and `time_split`.
    Those already too transparent to live are passed over. Where the cap binds, the largest ratio of indicator to
    threshold goes first, ties by index. Neither the cap nor the choice knows the background's sphere.
    """
    space, time = statistics.indicators()
    urgency, in_time = space / cfg.space_gradient, torch.zeros(len(model), dtype=torch.bool)
    if cfg.use_time_gradient and time_split and model.kind.dims == 4:
        in_time = time >= cfg.time_gradient
        urgency = torch.maximum(urgency, time / cfg.time_gradient)
    transparent = _transparent(model, cfg)
    others = torch.ones_like(transparent) if model.sphere is None else ~model.sphere
    selected = (urgency >= 1) & others & ~transparent
    big = _spatial_scale(model) > cfg.split_scale * extent
    added = torch.where(big, cfg.split_count - 1, 1)  # a split replaces its parent

    room = cfg.max_gaussians - int((others & ~transparent).sum())
    if int(added[selected].sum()) > room:
        order = torch.sort(urgency.masked_fill(~selected, -1.0), descending=True, stable=True).indices
        order = order[: int(selected.sum())]
        selected = torch.zeros_like(selected)
        selected[order[torch.cumsum(added[order], 0) <= room]] = True
    return Growth(clone=selected & ~big, split=selected & big, in_time=in_time)


def split_rows(
    model: Model, mask: Tensor, cfg: DensifyConfig, time_split: bool, generator: torch.Generator
) -> dict[str, Tensor]:
    """The `split_count` children of each Gaussian in `mask`, (count · split_count) rows, copies one after another.

    With `time_split` new means are drawn from the whole 4D Gaussian, N(μ, R diag(s)² Rᵀ): space and time jointly;
    all scales shrink. Without, μt and st stay, and the place is drawn from the Gaussian as it is at its own time μt,
    the conditional N(μ_xyz, Σ(μt)) (not the spatial marginal, which is smeared along the path of a moving one).
    """
    rows = {name: p[mask].repeat(cfg.split_count, *([1] * (p.dim() - 1))) for name, p in model.parameters.items()}
    dims = model.kind.dims
    noise = torch.randn(len(rows["mean"]), dims, generator=generator)
    axes = scaled_axes(Gaussians(**{"quat_right": None, **rows}))  # M = R diag(s), (n, dims, dims)
    if dims == 3 or time_split:
        rows["mean"] = rows["mean"] + (axes @ noise[:, :, None])[:, :, 0]
        shrinking = dims
    else:
        time_row = torch.nn.functional.normalize(axes[:, 3], dim=1)  # v of docs/method.md 1.1
        noise = noise - time_row * (time_row * noise).sum(dim=1, keepdim=True)  # (I - v vᵀ) ε
        rows["mean"][:, :3] += (axes[:, :3] @ noise[:, :, None])[:, :, 0]
        shrinking = 3
    rows["log_scale"][:, :shrinking] -= torch.log(torch.tensor(cfg.split_shrink))
    return rows


def to_prune(
    model: Model, radius: Tensor, iteration: int, cfg: DensifyConfig, extent: float, train_sphere: bool = True
) -> Tensor:
    """(N,) bool: too transparent, or, after `prune_big_after`, too big on the screen (`radius`, px) or in space."""
    transparent = _transparent(model, cfg)
    prune = transparent
    if iteration > cfg.prune_big_after:
        prune = prune | (radius > cfg.prune_radius_px) | (_spatial_scale(model) > cfg.prune_scale * extent)
    if model.sphere is not None:
        prune = torch.where(model.sphere, transparent & train_sphere, prune)
    return prune


def densify(
    optimiser: Adam,
    statistics: Statistics,
    iteration: int,
    cfg: DensifyConfig,
    extent: float,
    time_split: bool,
    generator: torch.Generator,
    train_sphere: bool = True,  # False: the background's sphere is frozen
) -> Densified:
    """Clone, split, then prune, on the optimiser's model. `statistics` no longer fit it afterwards.

    New order: the parents that were not split, clones, children of splits. New Gaussians have no radius yet.
    A prune that would leave nothing is not done: an empty model cannot recover.
    """
    model = optimiser.model
    growth = choose_growth(model, statistics, cfg, extent, time_split)
    clones = {name: p[growth.clone] for name, p in model.parameters.items()}
    if cfg.split_by_cause:
        parts = [
            split_rows(model, growth.split & growth.in_time, cfg, time_split, generator),
            split_rows(model, growth.split & ~growth.in_time, cfg, False, generator),
        ]
        children = {name: torch.cat([part[name] for part in parts]) for name in clones}
    else:
        children = split_rows(model, growth.split, cfg, time_split, generator)
    optimiser.keep(~growth.split)
    optimiser.append({name: torch.cat([clones[name], children[name]]) for name in clones})

    radius = torch.zeros(len(model))
    parents = statistics.radius[~growth.split]
    radius[: len(parents)] = parents
    prune = to_prune(model, radius, iteration, cfg, extent, train_sphere)
    pruned = int(prune.sum())
    if 0 < pruned < len(model):
        optimiser.keep(~prune)
    else:
        pruned = 0
    return Densified(int(growth.clone.sum()), int(growth.split.sum()), pruned, len(model))


def reset_opacity(optimiser: Adam, cfg: DensifyConfig, train_sphere: bool = True) -> None:
    """Bring every opacity down to at most `opacity_reset_to` and forget its moments (3DGS), but those of a sphere that
    is no longer trained."""
    highest = torch.logit(torch.tensor(cfg.opacity_reset_to, dtype=torch.float64)).item()
    sphere, logit = optimiser.model.sphere, optimiser.model.parameters["opacity_logit"]
    rows = slice(None) if sphere is None or train_sphere else ~sphere
    logit[rows] = logit[rows].clamp(max=highest)
    optimiser.zero_moments("opacity_logit", rows)


def _transparent(model: Model, cfg: DensifyConfig) -> Tensor:
    return torch.sigmoid(model.parameters["opacity_logit"]) < cfg.prune_opacity


def _spatial_scale(model: Model) -> Tensor:
    """(N,) the largest of the three first scales, world units."""
    return model.parameters["log_scale"][:, :3].amax(dim=1).exp()
