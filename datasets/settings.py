"""The settings of a scene, `scene=…`: where its data are and how they are read. Every key, its default and its range."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Optional

BACKGROUND_MODELS = ("none", "sphere", "envmap")
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


def require(condition: bool, key: str, expected: str, found: Any) -> None:
    """Raises ValueError, one line, unless the condition holds."""
    if not condition:
        raise ValueError(f"{key}: expected {expected}, found {found!r}")


def _is_color(value: Any) -> bool:
    return (
        isinstance(value, (list, tuple))
        and len(value) == 3
        and all(isinstance(c, (int, float)) and not isinstance(c, bool) and 0 <= c <= 1 for c in value)
    )
