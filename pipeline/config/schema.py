"""The schema of a run: every key, its type, its default and its range.

The files under conf/ hold differences from these defaults only. A key that is not here is refused by Hydra with
its name; a value out of range is refused by `__post_init__` with the key, the bound and what was found. The
schedule's part, `train`, is in train_config.py.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Optional

from pipeline.config.ranges import BACKGROUNDS, require
from pipeline.config.train_schema import TrainConfig

READERS = ("dnerf", "plenoptic", "video", "synthetic")
COLOR_NAMES = ("auto", "black", "white")  # of scene.background


@dataclass
class SceneConfig:
    """Where a scene comes from and how it is read."""

    # Names the run folder; may hold a slash. scene=dnerf, plenoptic and video take it from the folder of scene.path
    name: str = "dnerf"
    reader: str = "dnerf"  # dnerf | plenoptic | video | synthetic
    path: Optional[str] = None  # folder of the data; synthetic scenes make their own
    test_split: str = "test"  # dnerf: test | val, which split is held out
    # To choose settings by: every so many-th training view takes the place of the held-out ones. 0: off
    validation_every: int = 0
    validation_outermost: bool = False  # as many, but those that look from farthest outside
    test_cameras: list[int] = field(default_factory=lambda: [0])  # plenoptic, video: held out
    drop_cameras: list[int] = field(default_factory=list)  # plenoptic, video: left out altogether
    first_frame: int = 0  # plenoptic, video
    frames: int = 300  # plenoptic, video: at most so many from first_frame on; synthetic/counter: made
    downscale: int = 2  # images are read at 1/downscale of their size
    # Composed under transparent pixels: RGB in [0, 1], black or white. auto: where no image has alpha and their borders
    # are of one colour, that colour; else black
    background: Any = "auto"
    background_model: str = "none"  # none | sphere | envmap: how what is far outside the cameras is modelled
    cache: str = "results/cache"  # where synthetic scenes, decoded frames and COLMAP's results are kept
    size: int = 200  # synthetic: image width in pixels
    cameras: int = 12  # synthetic/counter: those held out among them
    train_views: int = 60  # the other synthetic scenes
    test_views: int = 12  # the other synthetic scenes
    seed: int = 0  # synthetic: the scene's own seed, apart from the run's
    init_points: int = 100_000  # random points that training starts from
    # [low, high] of the cube random points start in, canonical units; videos have bounds or a cube round their cameras
    init_box: list[float] = field(default_factory=lambda: [-1.2, 1.2])
    near: float = 0.2  # in the scene's normalised unit (Scene.unit)

    def __post_init__(self) -> None:
        require(self.reader in READERS, "scene.reader", ", ".join(READERS), self.reader)
        for key, minimum in (("test_cameras", 1), ("drop_cameras", 0)):
            numbers = getattr(self, key)
            require(
                len(numbers) >= minimum and all(n >= 0 for n in numbers) and len(set(numbers)) == len(numbers),
                f"scene.{key}",
                "different camera numbers, 0 or more",
                list(numbers),
            )
        require(self.first_frame >= 0, "scene.first_frame", ">= 0", self.first_frame)
        require(self.frames >= 1, "scene.frames", "at least 1", self.frames)
        require(
            self.background_model in BACKGROUNDS,
            "scene.background_model",
            ", ".join(BACKGROUNDS),
            self.background_model,
        )
        require(self.cameras >= 3, "scene.cameras", "at least 3", self.cameras)
        require(self.test_split in ("test", "val"), "scene.test_split", "test or val", self.test_split)
        require(
            self.validation_every == 0 or self.validation_every >= 2,
            "scene.validation_every",
            "at least 2, or 0 (off)",
            self.validation_every,
        )
        require(1 <= self.downscale <= 16, "scene.downscale", "1 to 16", self.downscale)
        require(
            self.background in COLOR_NAMES or _is_color(self.background),
            "scene.background",
            f"{', '.join(COLOR_NAMES)} or three values in [0, 1]",
            self.background,
        )
        if not isinstance(self.background, str):
            self.background = [float(channel) for channel in self.background]
        require(8 <= self.size <= 4096, "scene.size", "8 to 4096", self.size)
        require(self.train_views >= 1, "scene.train_views", "at least 1", self.train_views)
        require(self.test_views >= 1, "scene.test_views", "at least 1", self.test_views)
        require(self.init_points >= 1, "scene.init_points", "at least 1", self.init_points)
        require(
            len(self.init_box) == 2 and self.init_box[0] < self.init_box[1],
            "scene.init_box",
            "[low, high] with low < high",
            self.init_box,
        )
        require(self.near > 0, "scene.near", "> 0", self.near)


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
    max_distance: float = (
        100.0  # from the cameras' centre, in normalised units (Scene.unit); farther points are dropped
    )
    min_points: int = 100  # fewer end the run with advice
    shared_intrinsics: bool = True  # poses unknown: one lens for all cameras
    sphere_points: int = 100_000  # background=sphere: so many points on it
    sphere_radius: float = 10.0  # × the farthest camera or point from the scene's centre

    def __post_init__(self) -> None:
        require(self.source in ("auto", "random", "sfm"), "init.source", "auto, random or sfm", self.source)
        for key in ("seed", "min_angle_deg"):
            require(getattr(self, key) >= 0, f"init.{key}", ">= 0", getattr(self, key))
        for key in ("max_error_px", "max_distance", "sphere_radius"):
            require(getattr(self, key) > 0, f"init.{key}", "> 0", getattr(self, key))
        for key in ("max_features", "min_points", "sphere_points"):
            require(getattr(self, key) >= 1, f"init.{key}", "at least 1", getattr(self, key))
        require(self.min_track >= 2, "init.min_track", "at least 2", self.min_track)


@dataclass
class AblationConfig:
    """Which parts of the model are left out (docs/method.md 3)."""

    name: str = "full"  # names the run folder
    rotation_4d: bool = True  # False: one 3D rotation, no motion
    fourier_order: int = 2  # 0: colour constant in time
    time_split: bool = True  # False: split in space only, no temporal indicator
    sh_degree: int = 3  # highest degree of spherical harmonics
    static: Optional[bool] = None  # None: as the scene is; True: no time at all, ordinary 3DGS

    def __post_init__(self) -> None:
        require(0 <= self.fourier_order <= 2, "ablation.fourier_order", "0 to 2", self.fourier_order)
        require(0 <= self.sh_degree <= 3, "ablation.sh_degree", "0 to 3", self.sh_degree)


@dataclass
class EvaluateConfig:
    """What is measured and written after training (docs/method.md 4)."""

    lpips: bool = True  # needs weights: a download, once; without them the cells stay empty and say why
    best_on_test: bool = True  # also measure the model of the best test evaluation (the release's protocol)
    renders: int = 12  # test views written to renders/, spread evenly; -1: all
    videos: bool = True  # where a held-out camera filmed: its render beside the truth, and a bullet-time path, as mp4
    speed_repeats: int = 3  # frames a second: the fastest of so many passes over the test views

    def __post_init__(self) -> None:
        require(self.renders >= -1, "evaluate.renders", ">= -1 (-1: all)", self.renders)
        require(self.speed_repeats >= 1, "evaluate.speed_repeats", "at least 1", self.speed_repeats)


@dataclass
class Config:
    """One run: a function of this, the data and the seed."""

    scene: SceneConfig = field(default_factory=SceneConfig)
    init: InitConfig = field(default_factory=InitConfig)
    ablation: AblationConfig = field(default_factory=AblationConfig)
    train: TrainConfig = field(default_factory=TrainConfig)
    evaluate: EvaluateConfig = field(default_factory=EvaluateConfig)
    background: str = "auto"  # auto: the schedule's or the scene's background_model | none | sphere | envmap
    seed: int = 0  # of everything random in the run; >= 0
    threads: int = 0  # 0: all the machine has
    estimate: bool = False  # say what time, memory and disk the run will need, and stop there
    out: str = "results/runs/${scene.name}/${ablation.name}/${train.name}/seed${seed}"  # the run folder
    resume: bool = True  # go on with an interrupted run; false: start over

    def __post_init__(self) -> None:
        require(
            self.background in ("auto", *BACKGROUNDS), "background", ", ".join(("auto", *BACKGROUNDS)), self.background
        )
        require(self.seed >= 0, "seed", ">= 0", self.seed)
        require(self.threads >= 0, "threads", ">= 0 (0: all)", self.threads)

    @property
    def background_model(self) -> str:
        """none, sphere or envmap: what the command line says, else the schedule, else the scene."""
        if self.background != "auto":
            return self.background
        return self.train.background_model or self.scene.background_model


def _is_color(value: Any) -> bool:
    return (
        isinstance(value, (list, tuple))
        and len(value) == 3
        and all(isinstance(c, (int, float)) and not isinstance(c, bool) and 0 <= c <= 1 for c in value)
    )
