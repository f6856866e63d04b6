"""SceneConfig: the settings `scene.*`, which say where the data of a scene are and how they are read."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Optional

from datasets.readers import reader_names

BACKGROUND_MODELS = ("none", "sphere", "envmap", "cubemap")
WHOLE_SIZE = ("plenoptic", "synthetic", "kitti", "waymo")  # readers that choose no downscale by the size of the images
SYNC = ("none", "auto", "given")
SKY_MASKS = ("auto", "none", "files", "estimated")
STREET_LAYOUTS = ("processed", "kitti_format")
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
    test_split: str = "test"  # dnerf: the held-out split, test | val
    # Validation: every n-th training view replaces the test views, so that settings are not selected by these. 0: off
    validation_every: int = 0
    validation_outermost: bool = False  # validation by as many of the outermost training views instead
    # Cameras that move, folders without a test split: every so many-th frame is held out. 0: several cameras that move,
    # scene.test_cameras instead
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
    layout: str = "processed"  # synthetic/street: the layout it is written in, processed | kitti_format
    downscale: int = 2  # images are read at 1/downscale of their size; 0 (own data): chosen by the size
    # Colour under transparent pixels: black, white or RGB in [0, 1]. auto: the border colour of opaque images if all
    # borders have one colour, else black
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
    # [low, high] of the cube of random initial points, canonical units; not used by videos, whose box follows from
    # their bounds or cameras
    init_box: list[float] = field(default_factory=lambda: [-1.2, 1.2])
    near: float = 0.2  # near plane in the scene's normalised unit (Scene.unit)

    def __post_init__(self) -> None:
        readers = ("auto", *reader_names())
        require(self.reader in readers, "scene.reader", ", ".join(readers), self.reader)
        for key, minimum in (("test_cameras", 1), ("drop_cameras", 0)):
            numbers = getattr(self, key)
            require(
                len(numbers) >= minimum and all(n >= 0 for n in numbers) and len(set(numbers)) == len(numbers),
                f"scene.{key}",
                "different camera numbers, 0 or more",
                list(numbers),
            )
        require(self.sync in SYNC, "scene.sync", ", ".join(SYNC), self.sync)
        for key in ("moving_cameras", "color_correction"):
            value = getattr(self, key)
            require(value == "auto" or isinstance(value, bool), f"scene.{key}", "auto, true or false", value)
        require(self.first_frame >= 0, "scene.first_frame", ">= 0", self.first_frame)
        require(self.frames >= 1, "scene.frames", "at least 1", self.frames)
        require(
            self.test_every >= 2 or (self.test_every == 0 and self.reader in ("video", "auto")),
            "scene.test_every",
            "at least 2",
            self.test_every,
        )
        require(
            self.log_cameras is None
            or (0 < len(self.log_cameras) == len(set(self.log_cameras)) and min(self.log_cameras) >= 0),
            "scene.log_cameras",
            "different camera numbers, 0 or more",
            self.log_cameras and list(self.log_cameras),
        )
        require(self.sky_masks in SKY_MASKS, "scene.sky_masks", ", ".join(SKY_MASKS), self.sky_masks)
        require(self.layout in STREET_LAYOUTS, "scene.layout", ", ".join(STREET_LAYOUTS), self.layout)
        require(
            self.background_model in BACKGROUND_MODELS,
            "scene.background_model",
            ", ".join(BACKGROUND_MODELS),
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
        require(
            1 <= self.downscale <= 16 or (self.downscale == 0 and self.reader not in WHOLE_SIZE),
            "scene.downscale",
            "1 to 16",
            self.downscale,
        )
        require(
            self.background in COLOR_NAMES or _is_color(self.background),
            "scene.background",
            f"{', '.join(COLOR_NAMES)} or three values in [0, 1]",
            self.background,
        )
        if not isinstance(self.background, str):
            self.background = [float(channel) for channel in self.background]
        require(11 <= self.size <= 4096, "scene.size", "11 to 4096, as SSIM has a window of 11", self.size)
        require(self.train_views >= 1, "scene.train_views", "at least 1", self.train_views)
        require(self.test_views >= 1, "scene.test_views", "at least 1", self.test_views)
        require(self.camera_path in CAMERA_PATHS, "scene.camera_path", ", ".join(CAMERA_PATHS), self.camera_path)
        require(
            len(self.init_box) == 2 and self.init_box[0] < self.init_box[1],
            "scene.init_box",
            "[low, high] with low < high",
            self.init_box,
        )
        require(self.near > 0, "scene.near", "> 0", self.near)


def require(condition: bool, key: str, expected: str, found: Any) -> None:
    """Raises a ValueError of one line if the condition is false."""
    if not condition:
        raise ValueError(f"{key}: expected {expected}, found {found!r}")


def _is_color(value: Any) -> bool:
    return (
        isinstance(value, (list, tuple))
        and len(value) == 3
        and all(isinstance(c, (int, float)) and not isinstance(c, bool) and 0 <= c <= 1 for c in value)
    )
