"""What every reader returns: posed, timed images of one scene, and the checks any scene must pass.

A reader (`datasets/dnerf.py`, …) turns one layout on disk into a `Scene`; nothing after it knows the layout.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol, Union

import numpy as np

from datasets.files.errors import DataError
from rasterizer.arguments import SHORTEST_DURATION
from rasterizer.camera import Camera

# 3DGS scales its position learning rate by 1.1 × the distance of the farthest training camera from their centre.
EXTENT_MARGIN = 1.1

# Opposite corners, low and high; one number is the same on all three axes.
Corner = Union[float, tuple[float, float, float]]
Box = tuple[Corner, Corner]


class SceneError(DataError):
    """Data on disk is not what its layout promises. One line: the file or key, what was expected, what was found."""


class Image(Protocol):
    """Pixels (H, W, 3) uint8: an array, or something that reads one when asked for it (frames.StoredFrame)."""

    @property
    def shape(self) -> tuple[int, ...]: ...

    @property
    def dtype(self) -> np.dtype: ...

    def __array__(self, dtype: np.dtype | None = None, copy: bool | None = None) -> np.ndarray: ...


@dataclass(frozen=True)
class View:
    """One image: who saw it, when, and what was seen."""

    camera: Camera
    time: float  # in the scene's own unit, within [time_start, time_start + duration]; 0 when static
    image: Image  # already composed over the scene's background; np.asarray reads it
    name: str  # unique in the scene, e.g. "train/r_0"
    coverage: np.ndarray | None = None  # (H, W) uint8, 255 where no background shows; None: nowhere does it


@dataclass(frozen=True)
class Scene:
    """A scene split into the views to learn from and the views held out.

    Readers give it in the units of its files; canonical.py turns it into those that training works in.
    """

    name: str
    train: tuple[View, ...]
    test: tuple[View, ...]
    duration: float  # T of 4DSH's Fourier basis, in the unit of the times
    time_start: float
    background: tuple[float, float, float]  # RGB in [0, 1]
    extent: float  # world units, see camera_extent
    init_box: Box  # random points start in it, world units
    source: Path  # the folder it was read from
    unit: float = 1.0  # world units of one normalised unit, which the near plane is given in
    frame_rate: float | None = None  # frames of the videos it was filmed as in a unit of time; None: photographs
    shown_rate: float | None = None  # frames a second to show it at; None: frame_rate

    @property
    def time_end(self) -> float:
        return self.time_start + self.duration

    @cached_property
    def moments(self) -> tuple[float, ...]:
        """The times of the training views, each once, ascending."""
        return tuple(sorted({view.time for view in self.train}))

    @property
    def frame_spacing(self) -> float:
        """The mean time between training moments; the whole duration where there is one moment."""
        return self.duration / max(1, len(self.moments) - 1)

    @property
    def is_static(self) -> bool:
        """True when every view has the same time: such a scene has no use for a time axis."""
        return len({view.time for view in self.train + self.test}) <= 1


def camera_extent(cameras: Sequence[Camera]) -> float:
    """1.1 × the largest distance of a camera from the mean of their positions, world units; 0 for one position."""
    positions = np.stack([camera.position for camera in cameras])
    distances = np.linalg.norm(positions - positions.mean(axis=0), axis=1)
    return EXTENT_MARGIN * float(distances.max())


def cube_round(places: np.ndarray, margin: float = 0.0) -> Box:
    """The cube about the middle of `places` (N, 3) that holds them all, `margin` farther out on every side."""
    low, high = np.min(places, axis=0), np.max(places, axis=0)
    middle, half = 0.5 * (low + high), 0.5 * float(np.max(high - low)) + margin
    return tuple((middle - half).tolist()), tuple((middle + half).tolist())


def camera_of(where: str | Path, make: Callable[[], Camera]) -> Camera:
    """The camera that `make` makes of what a file says; SceneError that names the file where there can be none."""
    try:
        return make()
    except ValueError as error:
        raise SceneError(where, "what makes a camera", str(error)) from None


def validate_scene(scene: Scene) -> Scene:
    """The scene itself, if it can be trained on; otherwise SceneError.

    Checks what holds for any layout: views in both splits, one image size, images that fit their cameras, times
    in range, unique names, an extent above zero. What only one layout can get wrong is its reader's business.
    """
    for split, views in (("train", scene.train), ("test", scene.test)):
        if not views:
            raise SceneError(scene.source, f"at least one {split} view", "none")
    if not (0 < scene.duration < math.inf and math.isfinite(scene.time_start)):
        raise SceneError(
            scene.source, "a finite start and a duration > 0", f"start {scene.time_start}, duration {scene.duration}"
        )
    if scene.duration < SHORTEST_DURATION:
        raise SceneError(scene.source, f"a duration of at least {SHORTEST_DURATION:g}", f"{scene.duration:g}")
    if len(scene.background) != 3 or not all(0 <= channel <= 1 for channel in scene.background):
        raise SceneError(scene.source, "a background of three values in [0, 1]", f"{scene.background}")
    if not (
        np.isfinite(np.concatenate([np.ravel(corner) for corner in scene.init_box])).all()
        and np.less(*scene.init_box).all()
    ):
        raise SceneError(scene.source, "init_box [low, high] with low < high", f"{scene.init_box}")
    if not 0 < scene.unit < math.inf:
        raise SceneError(scene.source, "a unit > 0", f"{scene.unit}")

    first = scene.train[0]
    seen: set[str] = set()
    for view in scene.train + scene.test:
        _validate_view(view, scene, first)
        if view.name in seen:
            raise SceneError(scene.source, "each view's name once", f"{view.name} twice")
        seen.add(view.name)

    # Relative to the distance of the cameras from the origin: rounding alone must not pass for movement, but a rig of a
    # metre in coordinates of a map, which are millions of metres, must.
    reach = max(float(np.linalg.norm(view.camera.position)) for view in scene.train)
    if not scene.extent > 1e-9 * reach:
        raise SceneError(
            scene.source,
            "training cameras at two places or more (their spread scales the learning rate)",
            f"{len(scene.train)} at one place",
        )
    return scene


def _validate_view(view: View, scene: Scene, first: View) -> None:
    where = scene.source / view.name
    shape = (view.camera.height, view.camera.width, 3)
    if view.image.dtype != np.uint8 or view.image.shape != shape:
        raise SceneError(
            where, f"an image of uint8 {shape}, its camera's size", f"{view.image.dtype} {view.image.shape}"
        )
    if view.image.shape != first.image.shape:
        raise SceneError(
            where,
            f"{first.camera.width} x {first.camera.height} pixels as {first.name}",
            f"{view.camera.width} x {view.camera.height}",
        )
    if not scene.time_start <= view.time <= scene.time_end:  # also false for NaN
        raise SceneError(where, f"a time in [{scene.time_start:g}, {scene.time_end:g}]", f"{view.time}")
