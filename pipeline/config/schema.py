"""The schema of a run: every key, its type, its default and its range.

The files under conf/ hold differences from these defaults only. A key that is not here is refused by Hydra with
its name; a value out of range is refused by `__post_init__` with the key, the bound and what was found. The
part of the scene is in datasets/settings.py, that of the schedule in train_schema.py.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Optional

from datasets.ranges import at_least, check, one_of, positive_count, require
from datasets.settings import SceneConfig
from pipeline.config.train_schema import TrainConfig

MAX_SEED = 2**63 - 1  # int64, as checkpoints and tables hold it


@dataclass
class InitConfig:
    """Where the initial points come from."""

    # auto: given with the files, lidar where sweeps are, else sfm, else carved; random where these find too little, and
    # for one camera that jumps from time to time
    source: str = "auto"  # auto | given (with the files) | sfm | lidar | carved (a few cameras far apart) | random
    refine_poses: bool = False  # let COLMAP adjust the poses that came with the data
    max_features: int = 8192  # SIFT features an image
    min_points: int = 100  # fewer points end the run with advice
    shared_intrinsics: bool = True  # poses unknown: one lens for all cameras
    lidar_points: Optional[int] = None  # driving logs: initial points; None: half of train.densify.max_gaussians
    lidar_velocities: bool = True  # driving logs: what moves starts with the velocity that sweeps show
    sphere_points: int = 100_000  # points on the sphere of scene.background_model=sphere

    def __post_init__(self) -> None:
        check("init", self, {
            "source": one_of("auto", "given", "sfm", "lidar", "carved", "random"),
            "lidar_points": positive_count(),
            **dict.fromkeys(("max_features", "min_points", "sphere_points"), positive_count()),
        })  # fmt: skip


@dataclass
class AblationConfig:
    """Which parts of the model are ablated (docs/method.md 3)."""

    name: str = "full"  # names the run folder
    rotation_4d: bool = True  # False: one 3D rotation, no motion
    fourier_order: int = 2  # highest Fourier order of 4DSH; 0: colour constant in time
    time_split: bool = True  # False: split in space only, no temporal indicator
    shared_motion: bool = True  # False: no Gaussians that share trajectories, whatever validation would find
    add_by_error: bool = True  # whether Gaussians are added where and when the error is (docs/method.md 5.4)
    sh_degree: int = 3  # highest degree of spherical harmonics
    static: Optional[bool] = None  # None: as the scene is; True: no time at all, ordinary 3DGS

    def __post_init__(self) -> None:
        require(0 <= self.fourier_order <= 2, "ablation.fourier_order", "0 to 2", self.fourier_order)
        require(0 <= self.sh_degree <= 3, "ablation.sh_degree", "0 to 3", self.sh_degree)


@dataclass
class EvaluateConfig:
    """What is measured and written after training (docs/method.md 4)."""

    lpips: bool = True  # needs weights, downloaded once; without them tables say "not measured", and why
    # Folder with the four files of weights (pipeline/evaluation/lpips.py); None: torch.hub's cache, set by TORCH_HOME
    lpips_weights: Optional[str] = None
    best_on_test: bool = True  # also measure the model of the best test evaluation (the release's protocol)
    renders: int = 12  # test views written to renders/, evenly spread; -1: all
    videos: bool = True  # where a held-out camera filmed: its render beside the truth, and a bullet-time path, as mp4
    speed_repeats: int = 3  # frames a second: the fastest of so many passes over the test views

    def __post_init__(self) -> None:
        check("evaluate", self, {"renders": at_least(-1).but("-1: all"), "speed_repeats": positive_count()})


@dataclass
class Config:
    """One run: a function of this, the data and the seed."""

    scene: SceneConfig = field(default_factory=SceneConfig)
    init: InitConfig = field(default_factory=InitConfig)
    ablation: AblationConfig = field(default_factory=AblationConfig)
    train: TrainConfig = field(default_factory=TrainConfig)
    evaluate: EvaluateConfig = field(default_factory=EvaluateConfig)
    seed: int = 0  # of everything random in the run
    backend: str = "cpu"  # cpu: the compiled kernel | gsplat: a GPU (docs/gpu.md)
    threads: int = 0  # 0: all the cores this process may use
    estimate: bool = False  # print what time, memory and disk the run will need, and stop
    out: str = "results/runs/${scene.name}/${ablation.name}/${train.name}/seed${seed}"  # the run folder
    resume: bool = True  # continue an interrupted run; false: start over
    until: Optional[str] = None  # the last stage to do: prepare | settle | init | train | evaluate | page
    only: Any = field(default_factory=list)  # the stages to do, of a run that has done those before them; empty: all
    view: bool = False  # serve a page that shows the model while it is trained (docs/viewer.md)
    view_at: str = "127.0.0.1:8080"  # where; the next free port if it is taken. Other hosts can be reached by others

    def __post_init__(self) -> None:
        require(0 <= self.seed <= MAX_SEED, "seed", f"in 0..{MAX_SEED}", self.seed)
        require(self.backend in ("cpu", "gsplat"), "backend", "cpu or gsplat", self.backend)
        require(self.threads >= 0, "threads", ">= 0 (0: all)", self.threads)
        other = "other than trajectories under ablation.shared_motion=false"
        ablated = self.train.motion == "trajectories" and not self.ablation.shared_motion
        require(not ablated, "train.motion", other, self.train.motion)
