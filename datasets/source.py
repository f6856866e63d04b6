"""`Source`: data on disk as an object; `open_source` opens the one that a configuration names.

Each module of datasets/readers reads one layout, and its name is the value of scene.reader. It is imported when it is
needed: most scenes need no video decoder. A reader has

    read(folder, cfg, log)          of images with poses: the Scene, without validation split
    open_source(cfg, threads, log)  of other data, instead: the Source
    matches(path) -> str | None     for scene=auto: what is missing in a folder of this layout; None: nothing
    TITLE, PRECEDENCE               for scene=auto: what messages call it, and its place: the lowest is asked first
    as_found(cfg, log)              for scene=auto, optional: the settings where the folder decides more of them

Readers without `matches` are not tried by scene=auto.
"""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from datasets.files.contents import contents, refuse_no_video
from datasets.files.errors import SceneError
from datasets.readers import reader_names
from datasets.scene import Scene, validate_scene
from datasets.settings import SceneConfig
from datasets.validation import hold_out_every, hold_out_outermost
from rasterizer.camera import Camera

if TYPE_CHECKING:  # imports OpenCV
    from datasets.cameras.color import ColorCorrection

CALIBRATED = ("auto", "video")  # values of scene.reader with which scene.calibration gives the poses
MOST_LOOKED_AT = 20  # folders in one that is no layout
Log = Callable[[str], None]  # called with a line of text for the user


@dataclass(frozen=True)
class Photograph:
    """An image for structure from motion; all photographs show the same moment, or are frames of clips."""

    name: str  # of the camera, unique
    image: np.ndarray  # (H, W, 3) uint8
    camera: Camera | None = None  # None: pose and intrinsics are to be estimated
    held_out: bool = False  # only its pose is estimated; points and other poses must not depend on it
    lens: str = ""  # of several cameras that move: the one that took it; its photographs share intrinsics and colours
    time: float = 0.0  # seconds of the common clock, of several cameras that move

    @property
    def camera_name(self) -> str:
        """Of the camera that took it: photographs of cameras that stand still are called after their camera."""
        return self.lens or self.name


@dataclass(frozen=True)
class Calibration:
    """The cameras that structure from motion found, by the names of the photographs. Others are missing."""

    cameras: Mapping[str, Camera]  # of the undistorted photographs; empty: the given ones stay
    radial: Mapping[str, float]  # distortion of the lens, OpenCV's k1
    unit: float  # world units per normalised unit
    colors: Mapping[str, ColorCorrection]  # by the name of the camera; of those whose colours are corrected


@dataclass(frozen=True)
class Size:
    """Size of a scene as a run reads it."""

    train_views: int
    test_views: int
    width: int  # pixels, of the training images
    height: int


class Source(ABC):
    """Data on disk, checked when it is opened as far as that goes without keeping an image."""

    cfg: SceneConfig  # as the reader takes it
    # "estimated": structure from motion finds the poses of cameras that stand still, "of every frame": of others
    poses: Literal["given", "estimated", "of every frame"] = "given"
    several_videos: bool = False  # of cameras that filmed at one time
    unit: float = 1.0  # world units of the photographs' cameras per normalised unit

    @property
    def path(self) -> Path:
        """The folder or file, for messages."""
        return data_path(self.cfg)

    @property
    def points(self) -> Literal["given", "random", "sfm", "lidar"]:
        """Where initial points come from if init.source is auto; given: with the files, else triangulated."""
        return "given"

    @property
    def guessed_box(self) -> bool:
        """Whether Scene.init_box is a guess, which a better one from the cameras may replace for random points."""
        return self.points == "given"

    @property
    def held_out(self) -> Collection[str]:
        """The names of held-out cameras, of several videos."""
        return ()

    @property
    def one_lens(self) -> bool:
        """Whether cameras without poses may share a lens."""
        return True

    @property
    def stored_bytes(self) -> int:
        """Size of the decoded frames that `scene` adds to scene.cache."""
        return 0

    @abstractmethod
    def scene(self, found: Calibration | None = None) -> Scene:
        """The scene, in the units of the files; decodes. found: of `photographs`, required without given poses."""

    def photographs(self) -> list[Photograph]:
        """What structure from motion takes; nothing where poses and points are given."""
        return []

    def size(self) -> Size:
        """Without decoding all frames of videos; other scenes are read."""
        scene = self.scene()
        camera = scene.train[0].camera
        return Size(len(scene.train), len(scene.test), camera.width, camera.height)

    def seconds_per_frame(self) -> float:
        """Time that one thread takes to decode a frame, measured; where `stored_bytes` is not 0."""
        return 0.0


@dataclass(frozen=True)
class PosedImages(Source):
    """Images with poses in the files, one a time or all of a static scene. `read` gives the scene without validation
    split."""

    cfg: SceneConfig
    read: Callable[[], Scene]
    points: Literal["given", "random"] = "given"

    def scene(self, found: Calibration | None = None) -> Scene:
        scene = self.read()
        if not self.cfg.validation_every:
            return scene
        hold_out = hold_out_outermost if self.cfg.validation_outermost else hold_out_every
        return validate_scene(hold_out(scene, self.cfg.validation_every))


def open_source(cfg: SceneConfig, *, threads: int = 0, log: Log = print) -> Source:
    """The data of a configuration, in the layout of scene.reader or, if that is auto, of the files.

    Synthetic videos and logs are made first, unless they are in the cache. threads: for decoding; 0: all cores. Raises
    SceneError for invalid data and settings that do not fit them.
    """
    if cfg.calibration is not None:
        if cfg.reader not in (*CALIBRATED, "calibrated"):
            raise SceneError("scene.calibration", f"none for scene.reader={cfg.reader}, whose files have poses", "one")
        cfg = replace(cfg, reader="calibrated")
    reader = None if cfg.reader == "auto" else _reader(cfg.reader)
    if reader is None:
        name, line = detect(data_path(cfg))
        log(line)
        reader = _reader(name)
        cfg = reader.as_found(cfg, log) if hasattr(reader, "as_found") else replace(cfg, reader=name)
    if hasattr(reader, "open_source"):
        return reader.open_source(cfg, threads, log)
    return PosedImages(cfg, lambda: reader.read(data_folder(cfg), cfg, log))


def detect(path: Path) -> tuple[str, str]:
    """(name of the reader, the reasons in one line) of a folder or video. SceneError, with the reason for each layout,
    if it has none."""
    modules = {name: _reader(name) for name in reader_names()}
    tried = {name: module for name, module in modules.items() if hasattr(module, "matches")}
    in_order = sorted(tried.items(), key=lambda item: (item[1].PRECEDENCE, item[0]))
    if path.is_file():
        refuse_no_video(path, _near(path, in_order))
        return "video", f"{path.name}: taken for one clip (scene=video): it is a file"
    if not path.is_dir():
        raise SceneError(path, "a folder, or a video", "nothing there")
    refused: list[str] = []
    for name, module in in_order:
        reason = module.matches(path)
        if reason is None:
            instead = f"; not {', '.join(refused)}" if refused else ""
            return name, f"{path}: taken for {module.TITLE} (scene.reader={name}){instead}"
        refused.append(f"{module.TITLE} ({reason})")
    known = f"a layout that is known (driving logs: scene=kitti or scene=waymo){_near(path, in_order)}"
    raise SceneError(path, known, [f"none: it holds {contents(path)}; not {refused[0]}", *refused[1:]])


def _near(path: Path, readers: Sequence[tuple[str, Any]]) -> str:
    """`, perhaps /data/jug (COLMAP)`: the folder of the data, above `path` or in it; "" without one."""
    inner = sorted(folder for folder in path.iterdir() if folder.is_dir())[:MOST_LOOKED_AT] if path.is_dir() else []
    outer = path.absolute().parents[:3]
    for folder in (*outer, *inner):
        for name, module in readers:
            if (name != "video" or folder in inner) and module.matches(folder) is None:
                return f", perhaps {folder} ({module.TITLE})"
    return ""


def _reader(name: str) -> Any:
    return importlib.import_module(f"datasets.readers.{name}")


def data_path(cfg: SceneConfig) -> Path:
    """`scene.path`; SceneError without one."""
    if cfg.path is None:
        raise SceneError("scene.path", "the folder of the data (scene.path=DIR)", "none")
    return Path(cfg.path).expanduser()


def data_folder(cfg: SceneConfig) -> Path:
    """`scene.path`; SceneError if it is no folder."""
    path = data_path(cfg)
    if not path.is_dir():
        found = "a file" if path.exists() else "nothing there"
        raise SceneError(path, f"a folder in the layout of {cfg.reader}", found)
    return path


def without_validation(cfg: SceneConfig, footage: str) -> SceneConfig:
    """`cfg`; SceneError for scene.validation_every, which is for photographs with poses."""
    if cfg.validation_every:
        raise SceneError("scene.validation_every", f"0 for {footage}", str(cfg.validation_every))
    return cfg
