"""A photograph with its camera and time, as any layout describes it, and how a folder of them is read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from datasets.cameras.lens import Lens
from datasets.composition import Color
from rasterizer.camera import Camera

Log = Callable[[str], None]


@dataclass(frozen=True)
class LayoutOptions:
    """How a folder is read: settings of SceneConfig."""

    name: str  # of the scene
    downscale: int = 0  # 0: chosen, see composition.chosen_downscale
    test_every: int = 8  # where the layout has no test split
    test_cameras: Sequence[int] = (0,)  # where several cameras filmed
    drop_cameras: Sequence[int] = ()  # ignored
    first_frame: int = 0
    frames: int = 300  # largest number of different times in use, of cameras that stand still each
    background: Color | None = None  # under transparent pixels; None: see composition.chosen_background
    log: Log = print


@dataclass(frozen=True)
class Photograph:
    """An image file with its camera."""

    name: str  # unique; numbers in it give the order in time
    path: Path
    camera: Camera  # of the full-size, undistorted image
    lens: Lens | None = None  # None: no distortion
    time: float | None = None  # any unit and origin; None: unknown
    group: int = 0  # number of the physical camera
    test: bool | None = None  # held out by the layout; None: the layout does not say
    mask: Path | None = None  # an image, 0 where pixels do not count; None: all count
    folder: str = ""  # what names the physical camera: a folder, or a part of the file names
    size: tuple[int, int] | None = None  # (width, height) of the file, which is cut to the camera's; None: the camera's
    moment: str | None = None  # the part of the name that says when; None: the file name
