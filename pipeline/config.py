"""The schema of a run: every key, its type, its default and its range.

The files under conf/ hold differences from these defaults only. A key that is not here is refused by Hydra with
its name; a value out of range is refused by `__post_init__` with the key, the bound and what was found.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any, Optional


READERS = ("dnerf", "plenoptic", "video", "synthetic")
BACKGROUNDS = ("none", "sphere", "envmap")


def _require(condition: bool, key: str, expected: str, found: Any) -> None:
    if not condition:
        raise ValueError(f"{key}: expected {expected}, found {found!r}")


@dataclass
class SceneConfig:
    """Where a scene comes from and how it is read."""

    name: str = "dnerf"  # names the run folder; may hold a slash
    reader: str = "dnerf"  # dnerf | plenoptic | video | synthetic
    path: Optional[str] = None  # folder of the data; synthetic scenes make their own
    test_split: str = "test"  # dnerf: test | val, which split is held out
    test_cameras: list[int] = field(default_factory=lambda: [0])  # plenoptic, video: held out
    drop_cameras: list[int] = field(default_factory=list)  # plenoptic, video: left out altogether
    first_frame: int = 0  # plenoptic, video
    frames: int = 300  # plenoptic, video: at most so many from first_frame on; synthetic/counter: made
    downscale: int = 2  # images are read at 1/downscale of their size
    background: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    background_model: str = "none"  # none | sphere | envmap: how what is far outside the cameras is modelled
    cache: str = "results/cache"  # where synthetic scenes, decoded frames and COLMAP's results are kept
    size: int = 200  # synthetic: image width in pixels
    cameras: int = 12  # synthetic/counter: those held out among them
    train_views: int = 60  # the other synthetic scenes
    test_views: int = 12  # the other synthetic scenes
    seed: int = 0  # synthetic: the scene's own seed, apart from the run's
    init_points: int = 100_000
    # [low, high] of the cube random points start in, canonical units; videos have bounds or a cube round their cameras
    init_box: list[float] = field(default_factory=lambda: [-1.2, 1.2])
    near: float = 0.2  # in the scene's normalised unit (Scene.unit)

    def __post_init__(self) -> None:
        _require(self.reader in READERS, "scene.reader", ", ".join(READERS), self.reader)
        for key, minimum in (("test_cameras", 1), ("drop_cameras", 0)):
            numbers = getattr(self, key)
            _require(len(numbers) >= minimum and all(n >= 0 for n in numbers) and len(set(numbers)) == len(numbers),
                     f"scene.{key}", "different camera numbers, 0 or more", list(numbers))
        _require(self.first_frame >= 0, "scene.first_frame", ">= 0", self.first_frame)
        _require(self.frames >= 1, "scene.frames", "at least 1", self.frames)
        _require(self.background_model in BACKGROUNDS, "scene.background_model", ", ".join(BACKGROUNDS),
                 self.background_model)
        _require(self.cameras >= 3, "scene.cameras", "at least 3", self.cameras)
        _require(self.test_split in ("test", "val"), "scene.test_split", "test or val", self.test_split)
        _require(1 <= self.downscale <= 16, "scene.downscale", "1 to 16", self.downscale)
        _require(len(self.background) == 3 and all(0 <= c <= 1 for c in self.background),
                 "scene.background", "three values in [0, 1]", self.background)
        _require(8 <= self.size <= 4096, "scene.size", "8 to 4096", self.size)
        _require(self.train_views >= 1, "scene.train_views", "at least 1", self.train_views)
        _require(self.test_views >= 1, "scene.test_views", "at least 1", self.test_views)
        _require(self.init_points >= 1, "scene.init_points", "at least 1", self.init_points)
        _require(len(self.init_box) == 2 and self.init_box[0] < self.init_box[1],
                 "scene.init_box", "[low, high] with low < high", self.init_box)
        _require(self.near > 0, "scene.near", "> 0", self.near)


@dataclass
class InitConfig:
    """Where the first points come from. COLMAP's part applies to readers with several cameras at one time."""

    source: str = "auto"  # auto: sfm where several cameras filmed at once, otherwise random
    refine_poses: bool = False  # let COLMAP adjust the poses the data came with
    seed: int = 0  # COLMAP's, apart from the run's: runs of several seeds share its result
    max_features: int = 8192  # an image
    max_error_px: float = 2.0  # of reprojection; points above are dropped
    min_track: int = 3  # images a point must be seen in; two agree on a wrong match too easily
    min_angle_deg: float = 1.5  # largest angle between two of its rays; below it the depth is a guess
    max_distance: float = 100.0  # from the cameras' centre, in normalised units (Scene.unit); farther points are dropped
    min_points: int = 100  # fewer end the run with advice
    shared_intrinsics: bool = True  # poses unknown: one lens for all cameras
    sphere_points: int = 100_000
    sphere_radius: float = 10.0  # × the farthest camera or point from the scene's centre

    def __post_init__(self) -> None:
        _require(self.source in ("auto", "random", "sfm"), "init.source", "auto, random or sfm", self.source)
        for key in ("seed", "min_angle_deg"):
            _require(getattr(self, key) >= 0, f"init.{key}", ">= 0", getattr(self, key))
        for key in ("max_error_px", "max_distance", "sphere_radius"):
            _require(getattr(self, key) > 0, f"init.{key}", "> 0", getattr(self, key))
        for key in ("max_features", "min_points", "sphere_points"):
            _require(getattr(self, key) >= 1, f"init.{key}", "at least 1", getattr(self, key))
        _require(self.min_track >= 2, "init.min_track", "at least 2", self.min_track)


@dataclass
class AblationConfig:
    """Which parts of the model are left out (SPEC 3)."""

    name: str = "full"
    rotation_4d: bool = True  # False: one 3D rotation, no motion
    fourier_order: int = 2  # 0: colour constant in time
    time_split: bool = True  # False: split in space only, no temporal indicator
    sh_degree: int = 3
    static: Optional[bool] = None  # None: as the scene is; True: no time at all, ordinary 3DGS

    def __post_init__(self) -> None:
        _require(0 <= self.fourier_order <= 2, "ablation.fourier_order", "0 to 2", self.fourier_order)
        _require(0 <= self.sh_degree <= 3, "ablation.sh_degree", "0 to 3", self.sh_degree)


@dataclass
class RateConfig:
    """Learning rates of Adam (SPEC 2), in canonical units; positions are multiplied by the scene's extent."""

    mean: float = 1.6e-4
    mean_final: float = 1.6e-6  # log-linear over `decay_iterations`
    mean_time: float = 1.6e-4  # × extent, constant
    decay_iterations: int = 30_000
    sh_dc: float = 2.5e-3
    sh_rest: float = 1.25e-4
    opacity: float = 5e-2
    scale: float = 5e-3
    rotation: float = 1e-3
    environment: float = 2.5e-3  # of the learned environment map's pixels
    final_factor: float = 1.0  # every rate × this at the end, log-linear (fast: 0.1)

    def __post_init__(self) -> None:
        for f in fields(self):
            _require(getattr(self, f.name) >= 0, f"train.rate.{f.name}", ">= 0", getattr(self, f.name))


@dataclass
class DensifyConfig:
    """Adaptive density control in space and time (SPEC 2)."""

    start: int = 500
    stop: int = 15_000
    every: int = 100
    space_gradient: float = 2e-4  # NDC units, mean per view
    use_time_gradient: bool = True  # the switch `densify.time_gradient` of SPEC 2
    time_gradient: float = 1e-4  # |dL/dμt|, time in units of the duration
    time_split: bool = True
    split_scale: float = 0.01  # × extent: clone up to it, split above
    split_count: int = 2
    split_shrink: float = 1.6
    # The paper gives no number. Without a cap N on lego is 226,814 at iteration 4,100 and grows by 7,000 at each
    # densification, of which another 108 are due; with this one 30,000 iterations took 76 minutes on two busy cores.
    max_gaussians: int = 200_000
    prune_opacity: float = 0.005
    prune_big_after: int = 3000
    prune_radius_px: float = 20.0
    prune_scale: float = 0.1  # × extent
    opacity_reset_every: int = 3000  # 0: never
    opacity_reset_to: float = 0.01

    def __post_init__(self) -> None:
        _require(self.start >= 0, "train.densify.start", ">= 0", self.start)
        _require(self.stop >= 0, "train.densify.stop", ">= 0 (0: no densification)", self.stop)
        _require(self.space_gradient > 0, "train.densify.space_gradient", "> 0", self.space_gradient)
        _require(self.time_gradient > 0, "train.densify.time_gradient", "> 0", self.time_gradient)
        _require(self.split_scale > 0, "train.densify.split_scale", "> 0", self.split_scale)
        _require(self.opacity_reset_every >= 0, "train.densify.opacity_reset_every", ">= 0 (0: never)",
                 self.opacity_reset_every)
        _require(0 < self.opacity_reset_to < 1, "train.densify.opacity_reset_to", "in (0, 1)", self.opacity_reset_to)
        _require(self.every >= 1, "train.densify.every", "at least 1", self.every)
        _require(self.max_gaussians >= 1, "train.densify.max_gaussians", "at least 1", self.max_gaussians)
        _require(self.split_shrink > 1, "train.densify.split_shrink", "> 1", self.split_shrink)
        _require(self.split_count >= 2, "train.densify.split_count", "at least 2", self.split_count)
        _require(0 < self.prune_opacity < 1, "train.densify.prune_opacity", "in (0, 1)", self.prune_opacity)


@dataclass
class ResolutionStep:
    """Train at `scale` of the full resolution until `until` (a fraction of the schedule)."""

    until: float = 1.0
    scale: float = 1.0

    def __post_init__(self) -> None:
        _require(0 < self.until <= 1, "train.resolution_steps.until", "in (0, 1]", self.until)
        _require(0 < self.scale <= 1, "train.resolution_steps.scale", "in (0, 1]", self.scale)


@dataclass
class TrainConfig:
    """The schedule. The defaults are `train=paper`."""

    name: str = "paper"
    iterations: int = 30_000
    batch: int = 4
    sampler: str = "pairs"  # pairs: shuffled (view, time) | views_at_one_time | times_of_one_view
    resolution_scale: float = 1.0
    resolution_steps: list[ResolutionStep] = field(default_factory=list)  # coarse to fine; empty: full size throughout
    time_budget_s: Optional[float] = None  # stop after so many training seconds
    ssim_weight: float = 0.2
    rigid_weight: float = 0.0
    background_model: Optional[str] = None  # None: the scene's
    sphere_freeze_after: int = 10_000  # iterations; the sphere's Gaussians stay as they are from then on
    environment_height: int = 500  # rows of the environment map; twice as many columns
    environment_until: int = 5000  # iterations it is trained for
    optimiser: str = "adam"  # adam (dense, the paper's) | sparse_adam (touched Gaussians only)
    sh_degree_every: int = 1000  # +1 degree so often, to 3; 0: all at once
    # Fourier order 1, 2 from these iterations; empty: both at once
    fourier_at: list[int] = field(default_factory=lambda: [4000, 5000])
    init_opacity: float = 0.1
    init_time_scale: float = 0.5  # × duration
    init_time_margin: float = 0.0  # times uniform over the duration widened so much a side
    init_points: Optional[int] = None  # None: the scene's
    init_box: Optional[list[float]] = None  # canonical units; None: the scene's
    rate: RateConfig = field(default_factory=RateConfig)
    densify: DensifyConfig = field(default_factory=DensifyConfig)
    eval_every: int = 500
    eval_views: int = 30  # at most so many test views, spread evenly, each time; the final evaluation takes all
    checkpoint_every: int = 1000
    checkpoint_keep_moments: bool = True

    def __post_init__(self) -> None:
        _require(self.iterations >= 1, "train.iterations", "at least 1", self.iterations)
        _require(self.batch >= 1, "train.batch", "at least 1", self.batch)
        _require(self.sampler in ("pairs", "views_at_one_time", "times_of_one_view"), "train.sampler",
                 "pairs, views_at_one_time or times_of_one_view", self.sampler)
        _require(self.optimiser in ("adam", "sparse_adam"), "train.optimiser", "adam or sparse_adam", self.optimiser)
        _require(0 < self.resolution_scale <= 1, "train.resolution_scale", "in (0, 1]", self.resolution_scale)
        _require(0 <= self.ssim_weight <= 1, "train.ssim_weight", "in [0, 1]", self.ssim_weight)
        _require(self.time_budget_s is None or self.time_budget_s > 0, "train.time_budget_s", "> 0", self.time_budget_s)
        _require(self.eval_every >= 1, "train.eval_every", "at least 1", self.eval_every)
        _require(self.eval_views >= 1, "train.eval_views", "at least 1", self.eval_views)
        _require(self.checkpoint_every >= 1, "train.checkpoint_every", "at least 1", self.checkpoint_every)
        _require(0 < self.init_opacity < 1, "train.init_opacity", "in (0, 1)", self.init_opacity)
        _require(self.init_time_scale > 0, "train.init_time_scale", "> 0", self.init_time_scale)
        _require(self.init_time_margin >= 0, "train.init_time_margin", ">= 0", self.init_time_margin)
        _require(self.init_points is None or self.init_points >= 1, "train.init_points", "at least 1", self.init_points)
        _require(self.init_box is None or (len(self.init_box) == 2 and self.init_box[0] < self.init_box[1]),
                 "train.init_box", "[low, high] with low < high", self.init_box)
        _require(self.background_model is None or self.background_model in BACKGROUNDS, "train.background_model",
                 ", ".join(BACKGROUNDS), self.background_model)
        _require(self.sphere_freeze_after >= 0, "train.sphere_freeze_after", ">= 0", self.sphere_freeze_after)
        _require(self.environment_height >= 2, "train.environment_height", "at least 2", self.environment_height)
        _require(self.environment_until >= 0, "train.environment_until", ">= 0", self.environment_until)
        _require(self.rigid_weight >= 0, "train.rigid_weight", ">= 0", self.rigid_weight)
        _require(self.sh_degree_every >= 0, "train.sh_degree_every", ">= 0 (0: all at once)", self.sh_degree_every)
        _require(self.fourier_at == sorted(self.fourier_at) and len(self.fourier_at) <= 2,
                 "train.fourier_at", "at most two iterations in ascending order", self.fourier_at)
        untils = [step.until for step in self.resolution_steps]
        _require(untils == sorted(set(untils)), "train.resolution_steps", "`until` in ascending order", untils)


@dataclass
class EvaluateConfig:
    """What is measured and written after training (SPEC 5)."""

    lpips: bool = True  # needs weights: a download, once; without them the cells stay empty and say why
    best_on_test: bool = True  # also measure the model of the best test evaluation (the release's protocol)
    renders: int = 12  # test views written to renders/, spread evenly; -1: all
    videos: bool = True  # where a held-out camera filmed: its render beside the truth, and a bullet-time path, as mp4
    speed_repeats: int = 3  # frames a second: the fastest of so many passes over the test views

    def __post_init__(self) -> None:
        _require(self.renders >= -1, "evaluate.renders", ">= -1 (-1: all)", self.renders)
        _require(self.speed_repeats >= 1, "evaluate.speed_repeats", "at least 1", self.speed_repeats)


@dataclass
class Config:
    """One run: a function of this, the data and the seed."""

    scene: SceneConfig = field(default_factory=SceneConfig)
    init: InitConfig = field(default_factory=InitConfig)
    ablation: AblationConfig = field(default_factory=AblationConfig)
    train: TrainConfig = field(default_factory=TrainConfig)
    evaluate: EvaluateConfig = field(default_factory=EvaluateConfig)
    background: str = "auto"  # auto: the schedule's or the scene's background_model | none | sphere | envmap
    seed: int = 0
    threads: int = 0  # 0: all the machine has
    estimate: bool = False  # say what time, memory and disk the run will need, and stop there
    out: str = "results/runs/${scene.name}/${ablation.name}/${train.name}/seed${seed}"
    resume: bool = True

    def __post_init__(self) -> None:
        _require(self.background in ("auto", *BACKGROUNDS), "background", ", ".join(("auto", *BACKGROUNDS)),
                 self.background)
        _require(self.seed >= 0, "seed", ">= 0", self.seed)
        _require(self.threads >= 0, "threads", ">= 0 (0: all)", self.threads)

    @property
    def background_model(self) -> str:
        """none, sphere or envmap: what the command line says, else the schedule, else the scene."""
        if self.background != "auto":
            return self.background
        return self.train.background_model or self.scene.background_model
