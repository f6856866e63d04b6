"""Densification with an exact budget: Gaussians that have faded away move to where others are needed (3DGS-MCMC).

In place of cloning, splitting and pruning (densify.py), after Kheradmand et al., "3D Gaussian Splatting as Markov
Chain Monte Carlo" (2024): every so often the transparent ones are put onto opaque ones, drawn in proportion to their
opacity, and the number grows by a constant factor until the cap. A Gaussian that is now `copies` coincident ones keeps
its picture: opacity and size follow from that (their equations 9 and 10). Between times, noise along each Gaussian's
own axes lets the transparent ones wander. Time has no part in equation 10, which integrates along a ray: the fourth
scale stays.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from pipeline.densify import Densified, Statistics
from pipeline.model import Model
from pipeline.optimiser import Adam
from pipeline.train_config import DensifyConfig
from rasterizer.reference import scaled_axes

MOST_COPIES = 50  # of one Gaussian at once; beyond it their opacity would be lost in the pruning threshold
GATE_SHARPNESS, GATE_OPACITY = 100.0, 0.005  # noise is for the transparent: its factor is sigmoid(100 (0.005 - o))
NOISE_EVERY = 10  # iterations; √10 times as much then, the axes of all Gaussians being a pass over the model


def relocate(optimiser: Adam, cfg: DensifyConfig, generator: torch.Generator) -> tuple[Statistics, Densified]:
    """Move the transparent and grow towards the cap, on the optimiser's model. Those of a sphere stay out of it.

    New order: the opaque ones, then the copies. Sources and copies start with no moments.
    """
    model = optimiser.model
    opacity = torch.sigmoid(model.parameters["opacity_logit"])
    own = torch.ones(len(model), dtype=torch.bool) if model.sphere is None else ~model.sphere
    dead = own & (opacity < cfg.prune_opacity)
    count, live = int(own.sum()), (own & ~dead).nonzero().squeeze(1)
    if len(live) == 0:
        return Statistics(len(model)), Densified(0, 0, 0, len(model))
    added = max(0, min(cfg.max_gaussians, math.ceil(count * cfg.growth)) - count)
    moved = int(dead.sum())
    drawn = live[torch.multinomial(opacity[live], moved + added, replacement=True, generator=generator)] if (
        moved + added) else live[:0]
    copies = torch.bincount(drawn, minlength=len(model)).clamp_(max=MOST_COPIES - 1) + 1
    sources = (copies > 1).nonzero().squeeze(1)

    logit, shrink = shared(opacity[sources], copies[sources])
    model.parameters["opacity_logit"][sources] = logit
    model.parameters["log_scale"][sources, :3] += shrink.log()[:, None]
    for name in model.parameters:
        optimiser.zero_moments(name, sources)
    rows = {name: tensor[drawn].clone() for name, tensor in model.parameters.items()}
    if moved:
        optimiser.keep(~dead)
    optimiser.append(rows)
    return Statistics(len(model)), Densified(cloned=len(drawn), split=0, pruned=moved, total=len(model))


def shared(opacity: Tensor, copies: Tensor) -> tuple[Tensor, Tensor]:
    """(logit of the opacity, factor of the spatial scales) of each of `copies` coincident Gaussians that together
    look like one of `opacity`; (n,) each.

    o' = 1 - (1 - o)^(1/c), and the scales are divided by Σ_i=1..c Σ_k=0..i-1 C(i-1, k) (-1)^k o'^(k+1) / √(k+1) / o.
    In float64: the sum alternates.
    """
    o, c = opacity.double().clamp(max=1 - 1e-6), copies.double()
    new = -torch.expm1(torch.log1p(-o) / c)
    total = torch.zeros_like(o)
    for i in range(1, int(copies.max()) + 1 if len(copies) else 1):
        inner = torch.zeros_like(o)
        for k in range(i):
            inner += math.comb(i - 1, k) * (-1) ** k * new ** (k + 1) / math.sqrt(k + 1)
        total += torch.where(copies >= i, inner, 0)
    return torch.logit(new).to(opacity.dtype), (o / total).to(opacity.dtype)


def add_noise(model: Model, rate: float, strength: float, generator: torch.Generator) -> None:
    """Move the means by normal noise times Σ, in place, for NOISE_EVERY iterations at once.

    rate: the means' learning rate. In time too: the noise is one of the 4D Gaussian.
    """
    p = model.parameters
    axes = scaled_axes(model.gaussians())  # M, Σ = M Mᵀ
    gate = torch.sigmoid(GATE_SHARPNESS * (GATE_OPACITY - torch.sigmoid(p["opacity_logit"])))
    if model.sphere is not None:
        gate = gate.masked_fill(model.sphere, 0.0)
    noise = torch.randn(p["mean"].shape, generator=generator) * (gate * rate * strength * math.sqrt(NOISE_EVERY))[:, None]
    p["mean"] += (axes @ (axes.transpose(1, 2) @ noise[:, :, None]))[:, :, 0]
