"""The schema of a schedule, `train=…`: learning rates, densification, resolution, regularization, evaluation.

The defaults are `train=paper`; the files under conf/train/ hold differences from them only.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Optional

from datasets.ranges import Range, above, at_least, between, check, one_of, positive_count, require, some_of


@dataclass
class LearningRates:
    """Learning rates of Adam (docs/method.md 2), in canonical units; positions are multiplied by the scene's extent."""

    factor: float = 1.0  # × the rates of 3DGS that pipeline/training/schedule.py has
    # Iterations in which that of μ_xyz falls log-linearly to a hundredth; None: all of the schedule
    decay_iterations: Optional[int] = None
    time_decay: bool = False  # whether that of μt falls alike; False: constant, as in the paper and the release
    sh_rest: float = 1.25e-4  # of all coefficients but the one that is constant in time and direction
    sh_time: Optional[float] = None  # of coefficients that vary with time alone (degree 0); None: sh_rest
    sh_view_time: Optional[float] = None  # of coefficients that vary with direction and time; None: sh_rest
    velocity: float = 1.0  # of what a Gaussian moves in one st; × the rate of μ_xyz
    final_factor: float = 1.0  # every learning rate × this at the end (pipeline/training/schedule.py)

    def __post_init__(self) -> None:
        rates = {f.name: at_least(0) for f in fields(self) if f.name != "time_decay"}
        check("train.lr", self, rates | {"decay_iterations": positive_count(), "final_factor": above(0)})


@dataclass
class DensifyConfig:
    """Adaptive density control in space and time (docs/method.md 2)."""

    start: int = 500  # densification begins after this iteration
    stop: int = 15_000  # densification and opacity resets end before this iteration; 0: none
    every: int = 100  # iterations between densifications
    space_gradient: float = 2e-4  # threshold of the spatial indicator; NDC units, mean per view
    use_time_gradient: bool = True  # False: as the release, which computes the temporal indicator and never uses it
    # A clone and its original have opacity 1 - √(1 - α), so that both together look as one did. False: as in the paper
    correct_clones: bool = False
    # False: every split shrinks the temporal scale too, as in the paper. True: only splits by the temporal indicator do
    split_by_cause: bool = False
    # Ours: the paper names no cap. Without one lego has 226,814 Gaussians at iteration 4,100 and gains 7,000 at each of
    # 108 further densifications. With this one 30,000 iterations take 5,400 CPU seconds.
    max_gaussians: int = 200_000
    # Gaussians of the lowest image sensitivity are pruned, together this share of the total sensitivity; 0: none
    prune_sensitivity: float = 0.0
    prune_sensitivity_every: int = 500  # iterations between prunings by sensitivity
    # Gaussians added where and when the error is (pipeline/training/density/error_guided.py); × their number; 0: none
    add_by_error: float = 0.0
    add_by_error_every: int = 500  # iterations between such additions
    # Iterations between opacity resets, until `stop`; large Gaussians are pruned after the first. 0: neither
    opacity_reset_every: int = 3000

    def __post_init__(self) -> None:
        check("train.densify", self, {
            "start": at_least(0),
            "stop": at_least(0).but("0: no densification"),
            "space_gradient": above(0),
            "opacity_reset_every": at_least(0).but("0: never"),
            "prune_sensitivity": between("[0, 1)", 0, 1).but("0: nothing"),
            "prune_sensitivity_every": positive_count(),
            "add_by_error": at_least(0).but("0: none"),
            "add_by_error_every": positive_count(),
            "every": positive_count(),
            "max_gaussians": positive_count(),
        })  # fmt: skip


@dataclass
class ResolutionStep:
    """Train at `scale` of the full resolution until `until`, a fraction of the schedule."""

    until: float = 1.0  # fraction of the schedule, in (0, 1]
    scale: float = 1.0  # × the full resolution, in (0, 1]

    def __post_init__(self) -> None:
        fraction = between("(0, 1]", 0, 1)
        check("train.resolution_steps", self, {"until": fraction, "scale": fraction})


@dataclass
class RegularizationConfig:
    """Weights of the regularization terms (pipeline/training/objective/model_terms.py). 0: none."""

    opacity: float = 0.0  # towards transparency: × mean opacity
    reference_views: float = 0.0  # `opacity` is × this / number of training views; 0: it is as given
    rigid: float = 0.0  # towards neighbours that move along shared trajectories as a rigid body
    rigid_released: float = 0.0  # towards neighbours that move alike, as in the released program
    still_lifetime: float = 0.0  # Gaussians of a larger st do not move (still_gaussians.py); × duration; 0: all may
    flow: float = 0.0  # towards the optical flow measured in videos: × mean error, image widths

    def __post_init__(self) -> None:
        weights = {f.name: at_least(0).but("0: none") for f in fields(self)}
        check("train.regularization", self, weights)


@dataclass
class DepthConfig:
    """Weights of the losses on depth and sky (pipeline/training/objective/image_terms.py). 0: none."""

    lidar: float = 1.0  # of the inverse depth at LiDAR pixels, scene units; 0.1 in the authors' code (docs/urban.md)
    sfm: float = 0.0  # the same at the points of structure from motion, of scenes that start from them
    sky_inverse: float = 0.1  # of the inverse depth in the sky, as there

    def __post_init__(self) -> None:
        check("train.depth", self, {f.name: at_least(0).but("0: none") for f in fields(self)})


@dataclass
class TrainConfig:
    """The schedule. The defaults are `train=paper`."""

    name: str = "paper"  # names the run folder
    # Optimiser steps. On the command line it scales the schedule's other iteration numbers (pipeline/config/scaled.py)
    iterations: int = 30_000
    batch: int = 4  # views an iteration
    resolution_scale: float = 1.0  # × the size images were read at, throughout; evaluation too
    resolution_steps: list[ResolutionStep] = field(default_factory=list)  # coarse to fine; empty: full size throughout
    time_budget_s: Optional[float] = None  # stop after so many training seconds
    mse_weight: float = 0.0  # of MSE in the loss; PSNR is the logarithm of MSE; 3DGS and the paper have none
    regularization: RegularizationConfig = field(default_factory=RegularizationConfig)
    depth: DepthConfig = field(default_factory=DepthConfig)
    # Each view takes its temporal marginals at a time off by up to this; × spacing of the training times; 0: none
    marginal_jitter: float = 0.0
    optimiser: str = "adam"  # adam (dense, the paper's) | sparse_adam (Gaussians of the batch's views only)
    # How motion is trained (docs/method.md 5.1). rotations: the paper's quaternions; tracks: velocities with spatial
    # covariances and lifetimes, and brief Gaussians are linked to the tracks of what flies; trajectories: Gaussians
    # exist at all times and share these
    motion: str = "rotations"
    # Iterations from which SH degree 1, 2, 3 and Fourier order 1, 2 are trained
    orders_at: list[int] = field(default_factory=lambda: [1000, 2000, 3000, 4000, 5000])
    # Whether validation decides on shared motion and time-varying colour (pipeline/stages/decide.py), each by two short
    # trainings. False: no shared motion, time-varying colour. Without effect under a time budget
    select: bool = False
    init_time_scale: float = 0.5  # st of every initial Gaussian; × duration
    init_time_margin: float = 0.0  # initial μt are uniform over the duration widened by this a side; × duration
    init_points: int = 100_000  # random initial points
    lr: LearningRates = field(default_factory=LearningRates)
    densify: DensifyConfig = field(default_factory=DensifyConfig)
    # What the authors' programs did to the gradients of colour: detached, untrained, wrong_line (docs/baseline.md);
    # empty: they are exact
    released_gradients: list[str] = field(default_factory=list)
    eval_every: int = 500  # iterations between evaluations on held-out views; also at 1/2, 1/4, 1/8, 1/16 of it
    checkpoint_every: int = 1000  # iterations between checkpoints; more where these take minutes

    def __post_init__(self) -> None:
        check("train", self, {
            "iterations": positive_count(),
            "batch": positive_count(),
            "optimiser": one_of("adam", "sparse_adam"),
            "motion": one_of("rotations", "tracks", "trajectories"),
            "resolution_scale": between("(0, 1]", 0, 1),
            "mse_weight": at_least(0),
            "time_budget_s": above(0),
            "eval_every": positive_count(),
            "checkpoint_every": positive_count(),
            "init_time_scale": above(0),
            "init_time_margin": at_least(0),
            "init_points": positive_count(),
            "marginal_jitter": at_least(0).but("0: none"),
            "released_gradients": some_of("detached", "untrained", "wrong_line"),
            "orders_at": Range("five iterations, the first three and the last two in ascending order",
                               lambda at: len(at) == 5 and at == sorted(at[:3]) + sorted(at[3:])),
        })  # fmt: skip
        untils = [step.until for step in self.resolution_steps]
        require(untils == sorted(set(untils)), "train.resolution_steps", "`until` in ascending order", untils)
