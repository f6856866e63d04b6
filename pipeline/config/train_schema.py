"""The schema of a schedule, `train=…`: rates, densification, resolution, priors, and how often what is done.

The defaults are `train=paper`; the files under conf/train/ hold differences from them only.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any, Optional

from datasets.settings import BACKGROUND_MODELS, require


@dataclass
class LearningRates:
    """Learning rates of Adam (docs/method.md 2), in canonical units; positions are multiplied by the scene's extent."""

    mean: float = 1.6e-4  # of μ_xyz at the start; × extent
    mean_final: float = 1.6e-6  # log-linear over `decay_iterations`
    mean_time: float = 1.6e-4  # × extent, constant
    decay_iterations: int = 30_000  # from `mean` to `mean_final`
    sh_dc: float = 2.5e-3  # of the colour that is constant in time and direction
    sh_rest: float = 1.25e-4  # of all other coefficients
    sh_time: Optional[float] = None  # of colours that change with time alone (degree 0); None: sh_rest
    sh_view_time: Optional[float] = None  # of colours that change with both; None: sh_rest
    opacity: float = 5e-2  # of the logit
    scale: float = 5e-3  # of the log scales, all four
    rotation: float = 1e-3  # of both quaternions
    environment_map: float = 2.5e-3  # of the learned environment map's pixels
    final_factor: float = 1.0  # every rate × this at the end, log-linear
    decay_start: float = 0.0  # part of the schedule before that decay begins

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            require(value is None or value >= 0, f"train.lr.{f.name}", ">= 0", value)
        require(self.decay_start < 1, "train.lr.decay_start", "in [0, 1)", self.decay_start)


@dataclass
class DensifyConfig:
    """Adaptive density control in space and time (docs/method.md 2)."""

    start: int = 500  # densification begins after this iteration
    stop: int = 15_000  # densification and opacity resets end before this iteration; 0: none
    every: int = 100  # iterations between densifications
    space_gradient: float = 2e-4  # NDC units, mean per view
    use_time_gradient: bool = True  # False: as the release, which computes it and never uses it
    time_gradient: float = 1e-4  # |dL/dμt|, time in units of the duration
    time_split: bool = True  # False: a split samples positions in space only, and time asks for none
    # False: as the paper, whatever asks for a split shrinks the lifetime too. True: only what time asked for
    split_by_cause: bool = False
    split_scale: float = 0.01  # × extent: clone up to it, split above
    split_count: int = 2  # Gaussians that take the place of a split one
    split_shrink: float = 1.6  # their scales: divided by this
    # The paper gives no number. Without a cap N on lego is 226,814 at iteration 4,100 and grows by 7,000 at each
    # densification, of which another 108 are due; with this one 30,000 iterations take 46 minutes on two cores.
    max_gaussians: int = 200_000
    prune_opacity: float = 0.005  # less opaque Gaussians are removed
    prune_big_after: int = 3000  # iteration after which big ones are removed too, by the next two keys
    prune_radius_px: float = 20.0  # on the screen
    prune_scale: float = 0.1  # × extent
    # Remove what the training images miss least, together this share of what they miss of all (sensitivity_pruning.py); 0: nothing
    prune_sensitivity: float = 0.0
    prune_sensitivity_every: int = 500  # iterations
    opacity_reset_every: int = 3000  # 0: never
    opacity_reset_to: float = 0.01  # at most so much after a reset

    def __post_init__(self) -> None:
        require(self.start >= 0, "train.densify.start", ">= 0", self.start)
        require(self.stop >= 0, "train.densify.stop", ">= 0 (0: no densification)", self.stop)
        require(self.space_gradient > 0, "train.densify.space_gradient", "> 0", self.space_gradient)
        require(self.time_gradient > 0, "train.densify.time_gradient", "> 0", self.time_gradient)
        require(self.split_scale > 0, "train.densify.split_scale", "> 0", self.split_scale)
        require(
            self.opacity_reset_every >= 0,
            "train.densify.opacity_reset_every",
            ">= 0 (0: never)",
            self.opacity_reset_every,
        )
        require(0 < self.opacity_reset_to < 1, "train.densify.opacity_reset_to", "in (0, 1)", self.opacity_reset_to)
        require(
            0 <= self.prune_sensitivity < 1,
            "train.densify.prune_sensitivity",
            "in [0, 1) (0: nothing)",
            self.prune_sensitivity,
        )
        require(
            self.prune_sensitivity_every >= 1,
            "train.densify.prune_sensitivity_every",
            "at least 1",
            self.prune_sensitivity_every,
        )
        require(self.every >= 1, "train.densify.every", "at least 1", self.every)
        require(self.max_gaussians >= 1, "train.densify.max_gaussians", "at least 1", self.max_gaussians)
        require(self.split_shrink > 1, "train.densify.split_shrink", "> 1", self.split_shrink)
        require(self.split_count >= 2, "train.densify.split_count", "at least 2", self.split_count)
        require(0 < self.prune_opacity < 1, "train.densify.prune_opacity", "in (0, 1)", self.prune_opacity)


@dataclass
class ResolutionStep:
    """Train at `scale` of the full resolution until `until` (a fraction of the schedule)."""

    until: float = 1.0  # part of the schedule, in (0, 1]
    scale: float = 1.0  # × the full resolution, in (0, 1]

    def __post_init__(self) -> None:
        require(0 < self.until <= 1, "train.resolution_steps.until", "in (0, 1]", self.until)
        require(0 < self.scale <= 1, "train.resolution_steps.scale", "in (0, 1]", self.scale)


@dataclass
class RegularizationConfig:
    """Pulls towards a simpler model, which what the images say must outweigh (regularization.py). 0: no pull."""

    motion: float = 0.0  # towards standing still: × mean tilt between space and time, radians
    lifetime: float = 0.0  # towards living long: × mean of (frame spacing / st)
    color: float = 0.0  # towards one colour from everywhere, at all times: decay per unit of the coefficients' rate
    opacity: float = 0.0  # towards transparency: × mean opacity
    opacity_views: float = 0.0  # of one camera: weaker where more than this share a lifetime; 0: all alike

    def __post_init__(self) -> None:
        for f in fields(self):
            require(
                getattr(self, f.name) >= 0, f"train.regularization.{f.name}", ">= 0 (0: none)", getattr(self, f.name)
            )


@dataclass
class TrainConfig:
    """The schedule. The defaults are `train=paper`."""

    name: str = "paper"  # names the run folder
    iterations: int = 30_000  # optimiser steps
    batch: int = 4  # views an iteration
    sampler: str = "pairs"  # pairs: shuffled (view, time) | views_at_one_time | times_of_one_view
    resolution_scale: float = 1.0  # × the size images were read at, throughout; evaluation too
    resolution_steps: list[ResolutionStep] = field(default_factory=list)  # coarse to fine; empty: full size throughout
    time_budget_s: Optional[float] = None  # stop after so many training seconds
    ssim_weight: float = 0.2  # w of the loss (1 - w) L1 + w (1 - SSIM)
    rigid_weight: float = 0.0  # of the release's rigid loss; 0: none
    regularization: RegularizationConfig = field(default_factory=RegularizationConfig)
    random_background: bool = False  # compose transparent images over a new colour each time
    background_model: Optional[str] = None  # None: the scene's
    sphere_freeze_after: int = 10_000  # iterations; the sphere's Gaussians stay as they are from then on
    envmap_height: int = 500  # rows of the environment map; twice as many columns
    envmap_until: int = 5000  # iterations it is trained for
    optimiser: str = "adam"  # adam (dense, the paper's) | sparse_adam (touched Gaussians only)
    sh_degree_every: int = 1000  # +1 degree so often, to 3; 0: all at once
    # Fourier order 1, 2 from these iterations; empty: both at once
    fourier_at: list[int] = field(default_factory=lambda: [4000, 5000])
    # As this share of the schedule two trainings on three quarters of the cameras, with and without colours that change
    # with time; these go where the other quarter gains too little by them (select_time_colour.py). 0: none. Not under a time budget
    select_time_colour: float = 0.0
    init_opacity: float = 0.1  # of every Gaussian at the start
    init_time_scale: float = 0.5  # × duration
    init_time_margin: float = 0.0  # times uniform over the duration widened so much a side
    init_points: Optional[int] = None  # None: the scene's
    init_box: Optional[list[float]] = None  # canonical units; None: the scene's
    lr: LearningRates = field(default_factory=LearningRates)
    densify: DensifyConfig = field(default_factory=DensifyConfig)
    # Keys of `train` that differ where nothing moves (static_overrides.py); null once they are filled in
    static_overrides: Optional[dict[str, Any]] = field(default_factory=dict)
    eval_every: int = 500  # iterations between evaluations on held-out views
    eval_views: int = 30  # at most so many test views, spread evenly, each time; the final evaluation takes all
    checkpoint_every: int = 1000  # iterations between checkpoints
    checkpoint_keep_moments: bool = True  # False: the last checkpoint is without Adam's moments

    def __post_init__(self) -> None:
        require(self.iterations >= 1, "train.iterations", "at least 1", self.iterations)
        require(self.batch >= 1, "train.batch", "at least 1", self.batch)
        require(
            self.sampler in ("pairs", "views_at_one_time", "times_of_one_view"),
            "train.sampler",
            "pairs, views_at_one_time or times_of_one_view",
            self.sampler,
        )
        require(self.optimiser in ("adam", "sparse_adam"), "train.optimiser", "adam or sparse_adam", self.optimiser)
        require(0 < self.resolution_scale <= 1, "train.resolution_scale", "in (0, 1]", self.resolution_scale)
        require(0 <= self.ssim_weight <= 1, "train.ssim_weight", "in [0, 1]", self.ssim_weight)
        require(self.time_budget_s is None or self.time_budget_s > 0, "train.time_budget_s", "> 0", self.time_budget_s)
        require(self.eval_every >= 1, "train.eval_every", "at least 1", self.eval_every)
        require(self.eval_views >= 1, "train.eval_views", "at least 1", self.eval_views)
        require(self.checkpoint_every >= 1, "train.checkpoint_every", "at least 1", self.checkpoint_every)
        require(
            0 <= self.select_time_colour < 1, "train.select_time_colour", "in [0, 1) (0: none)", self.select_time_colour
        )
        require(0 < self.init_opacity < 1, "train.init_opacity", "in (0, 1)", self.init_opacity)
        require(self.init_time_scale > 0, "train.init_time_scale", "> 0", self.init_time_scale)
        require(self.init_time_margin >= 0, "train.init_time_margin", ">= 0", self.init_time_margin)
        require(self.init_points is None or self.init_points >= 1, "train.init_points", "at least 1", self.init_points)
        require(
            self.init_box is None or (len(self.init_box) == 2 and self.init_box[0] < self.init_box[1]),
            "train.init_box",
            "[low, high] with low < high",
            self.init_box,
        )
        require(
            self.background_model is None or self.background_model in BACKGROUND_MODELS,
            "train.background_model",
            ", ".join(BACKGROUND_MODELS),
            self.background_model,
        )
        require(self.sphere_freeze_after >= 0, "train.sphere_freeze_after", ">= 0", self.sphere_freeze_after)
        require(self.envmap_height >= 2, "train.envmap_height", "at least 2", self.envmap_height)
        require(self.envmap_until >= 0, "train.envmap_until", ">= 0", self.envmap_until)
        require(self.rigid_weight >= 0, "train.rigid_weight", ">= 0", self.rigid_weight)
        require(self.sh_degree_every >= 0, "train.sh_degree_every", ">= 0 (0: all at once)", self.sh_degree_every)
        require(
            self.fourier_at == sorted(self.fourier_at) and len(self.fourier_at) <= 2,
            "train.fourier_at",
            "at most two iterations in ascending order",
            self.fourier_at,
        )
        untils = [step.until for step in self.resolution_steps]
        require(untils == sorted(set(untils)), "train.resolution_steps", "`until` in ascending order", untils)
