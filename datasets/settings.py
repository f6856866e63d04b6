"""SceneConfig: the settings `scene.*`, which say where the data of a scene are and how they are read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Optional

from datasets.ranges import Range, above, at_least, check, one_of, positive_count, require
from datasets.readers import reader_names

BACKGROUND_MODELS = ("none", "sphere", "envmap", "cubemap")
WHOLE_SIZE = ("plenoptic", "synthetic", "kitti", "waymo")  # readers that choose no downscale by the size of the images
CAMERA_PATHS = ("jumps", "arc")
COLOR_NAMES = ("auto", "black", "white")  # of scene.background


@dataclass
class SceneConfig:
    """Every key with its default; __post_init__ checks the ranges."""

    # Name of the scene and of its run folder; may contain a slash. By default derived from the folder of scene.path
    name: str = "dnerf"
    # Layout of the data: dnerf | plenoptic | video | synthetic | colmap | nerfstudio | dynamic_gaussians | nerfies |
    # llff | kitti | waymo (a module of datasets/readers) | auto: found out and said
    reader: str = "dnerf"
    path: Optional[str] = None  # folder of the data; not used by synthetic scenes
    # Folders of synchronised videos or images: the file or folder with intrinsics, lenses and poses of their cameras
    calibration: Optional[str] = None
    test_split: str = "test"  # dnerf: the held-out split, test | val
    # Validation: every n-th training view replaces the test views, so that settings are not selected by these. 0: off
    validation_every: int = 0
    validation_outermost: bool = False  # validation by as many of the outermost training views instead
    # Cameras that move, folders without a test split: every so many-th frame is held out. 0: scene.test_cameras
    # instead, of several cameras that move and of photographs of one instant
    test_every: int = 8
    # Several cameras, but for D-NeRF's layout and driving logs: numbers of held-out cameras
    test_cameras: list[int] = field(default_factory=lambda: [0])
    drop_cameras: list[int] = field(default_factory=list)  # several cameras, not D-NeRF's layout: numbers to ignore
    # Videos of several cameras: none: synchronised | auto: starts found by sound, else by the picture | given: offsets
    sync: str = "none"
    offsets: list[float] = field(default_factory=list)  # seconds at which each camera started, in the order of names
    # Videos of several cameras: whether some of them move. auto: looked at | true: all of them | false
    moving_cameras: Any = False
    # Several cameras: exposure and white balance made equal by matched points. auto: where it is shown to help | true:
    # every camera | false
    color_correction: Any = False
    first_frame: int = 0  # plenoptic, video, driving logs: the first frame in use, counted from 0
    # plenoptic, video, driving logs: largest number of frames in use; synthetic/counter, synthetic/street: to render
    frames: int = 300
    log_cameras: Optional[list[int]] = None  # driving logs: numbers of the cameras in use; None: the layout's
    # Driving logs: auto: masks that come with the data, else estimated from colour, edges and LiDAR | none | files |
    # estimated
    sky_masks: str = "auto"
    downscale: int = 2  # images are read at 1/downscale of their size; 0 (own data): chosen by the size
    # Colour under transparent pixels: black, white or RGB in [0, 1]. auto: the one colour that images have there, or
    # that opaque images have at their borders, else black
    background: Any = "auto"
    background_model: str = "none"  # model of the distant background: none | sphere | envmap | cubemap
    cache: str = "results/cache"  # folder of synthetic scenes, decoded frames and COLMAP's results
    size: int = 200  # synthetic: image width in pixels
    cameras: int = 12  # synthetic/counter: number of cameras, held-out ones included
    train_views: int = 60  # other synthetic scenes: number of training views
    test_views: int = 12  # other synthetic scenes: number of test views
    # Other synthetic scenes: jumps: each time from another side, as D-NeRF | arc: one camera that moves, a clip; test
    # views lie beside the camera, validation views (scene.test_split=val) on its path
    camera_path: str = "jumps"
    seed: int = 0  # synthetic: seed of the scene; the run has its own
    # [low, high] of the cube of random initial points, canonical units. None: [-1.2, 1.2] where that is about what most
    # cameras see, else what they see
    init_box: Optional[list[float]] = None
    # One moving camera: whether short trainings decide if the scene is static (pipeline/stages/decide.py)
    may_be_static: bool = False
    near: float = 0.2  # near plane in the scene's normalised unit (Scene.unit)

    def __post_init__(self) -> None:
        splits = ("dnerf", *WHOLE_SIZE)  # readers of layouts that say what is held out, or by another rule
        some = "different camera numbers, 0 or more"
        check("scene", self, {
            "reader": one_of("auto", *reader_names()),
            **dict.fromkeys(("test_cameras", "log_cameras"), Range(some, lambda n: len(n) > 0 and _are_numbers(n))),
            "drop_cameras": Range(some, _are_numbers),
            "sync": one_of("none", "auto", "given"),
            "first_frame": at_least(0),
            **dict.fromkeys(("frames", "train_views", "test_views"), positive_count()),
            "test_every": Range("at least 2", lambda n: n >= 2 or (n == 0 and self.reader not in splits)),
            "sky_masks": one_of("auto", "none", "files", "estimated"),
            "background_model": one_of(*BACKGROUND_MODELS),
            "cameras": positive_count(3),
            "test_split": one_of("test", "val"),
            "validation_every": Range("at least 2, or 0 (off)", lambda n: n == 0 or n >= 2),
            "downscale": Range("1 to 16", lambda n: 1 <= n <= 16 or (n == 0 and self.reader not in WHOLE_SIZE)),
            "size": Range("11 to 4096, as SSIM has a window of 11", lambda n: 11 <= n <= 4096),
            "camera_path": one_of(*CAMERA_PATHS),
            "init_box": Range("[low, high] with low < high", lambda b: b is None or len(b) == 2 and b[0] < b[1]),
            "near": above(0),
        })  # fmt: skip
        outermost = "true only with scene.validation_every, which says how many"
        require(
            bool(self.validation_every) or not self.validation_outermost, "scene.validation_outermost", outermost, True
        )
        given = "nothing without scene.sync=given, where it is used"
        require(not self.offsets or self.sync == "given", "scene.offsets", given, list(self.offsets))
        for key in ("moving_cameras", "color_correction"):  # None is no value of these
            value = getattr(self, key)
            require(value == "auto" or isinstance(value, bool), f"scene.{key}", "auto, true or false", value)
        colors = f"{', '.join(COLOR_NAMES)} or three values in [0, 1]"
        require(_is_background(self.background), "scene.background", colors, self.background)
        if not isinstance(self.background, str):
            self.background = [float(channel) for channel in self.background]


def _are_numbers(cameras: Sequence[int]) -> bool:
    return all(n >= 0 for n in cameras) and len(set(cameras)) == len(cameras)


def _is_background(value: Any) -> bool:
    return value in COLOR_NAMES or (
        isinstance(value, (list, tuple))
        and len(value) == 3
        and all(isinstance(c, (int, float)) and not isinstance(c, bool) and 0 <= c <= 1 for c in value)
    )
