"""`Scene`: the posed, timed images that every reader returns, and `validate_scene`, the checks for all of them.

A reader (`datasets/readers`) turns one layout on disk into a `Scene`; no other code depends on the layout.
"""

from __future__ import annotations

import math
import statistics
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal, Protocol

import numpy as np

from datasets.files.errors import SceneError
from datasets.ground_truth import StoredTruth
from datasets.outliers import without_outliers
from rasterizer.camera import Camera
from rasterizer.request import MIN_DURATION

# 3DGS scales its position learning rate by 1.1 × the distance of the farthest training camera from their centre.
EXTENT_MARGIN = 1.1
SMALLEST_EXTENT = 1e-12  # world units: less is the rounding of poses around the origin
PLAYBACK_RATE = 30.0  # frames a second of rendered videos of one moving camera, where the data say nothing

# What sort of scene the data are:
# static      every view has one time
# monocular   photographs of a dynamic scene, one at a time, from anywhere
# clip        one camera filmed it: images in order of time, neighbours are nearly the same view
# multi_view  several cameras: each time is seen from two places or more, or the cameras need not be synchronised
# drive       cameras on a car
Capture = Literal["static", "monocular", "clip", "multi_view", "drive"]

# Opposite corners, low and high; one number is the same on all three axes.
Corner = float | tuple[float, float, float]
Box = tuple[Corner, Corner]
USUAL_BOX: Box = (-1.2, 1.2)  # canonical units: what D-NeRF's cameras see


class Image(Protocol):
    """Pixels (H, W, 3) uint8: an array, or an object that `np.asarray` reads (frame_store.StoredFrame)."""

    @property
    def shape(self) -> tuple[int, ...]: ...

    @property
    def dtype(self) -> np.dtype: ...

    def __array__(self) -> np.ndarray: ...


@dataclass(frozen=True)
class View:
    """One image with its camera and time."""

    camera: Camera
    time: float  # the scene's unit, within [time_start, time_start + duration]; 0 if the scene is static
    image: Image  # already composed over the scene's background
    name: str  # unique in the scene, e.g. "train/r_0"
    coverage: np.ndarray | None = None  # (H, W) uint8, alpha × 255; None: opaque everywhere
    truth: StoredTruth | None = None  # of motion and geometry, read when asked for; None: unknown
    frame: int | None = None  # of a driving log: views and sweep of one moment share it
    sky: np.ndarray | None = None  # (H, W) bool; None: unknown
    moving: np.ndarray | None = None  # (H, W) bool, what moves by a mask of the data; None: unknown
    mask: np.ndarray | None = None  # (H, W) bool: pixels that count in the loss and in psnr_masked; None: all
    filmed_by: str = ""  # the camera, of several that filmed; "": of one, or of photographs


@dataclass(frozen=True)
class Sweep:
    """One LiDAR sweep: the points where its beams met a surface."""

    frame: int  # as View.frame
    time: float  # as View.time
    origin: np.ndarray  # (3,) float64, where the beams start, world units
    points: np.ndarray  # (N, 3) float64, world units


@dataclass(frozen=True)
class ScenePoints:
    """Surface points that came with the data or were triangulated."""

    positions: np.ndarray  # (N, 3) float64, world units
    colors: np.ndarray  # (N, 3) uint8
    times: np.ndarray | None = None  # (N,) when what moves is there, NaN: always; None: surfaces, at unknown times
    span: float = 0.0  # standard deviation in time of what moves
    # Name of a training view -> rows of the points that it and its camera at other times show; None: unknown
    seen_by: Mapping[str, np.ndarray] | None = None
    sparse: bool = False  # too few to start from without random points beside them


@dataclass(frozen=True)
class Scene:
    """Training views and held-out views of one scene.

    Readers return it in the units of its files; canonical.py converts it to the units of training.
    """

    name: str
    train: tuple[View, ...]
    test: tuple[View, ...]
    duration: float  # period T of 4DSH's Fourier basis, in the unit of the times
    time_start: float
    background: tuple[float, float, float]  # RGB in [0, 1]
    extent: float  # world units, see camera_extent
    init_box: Box  # random initial points are drawn in it, world units
    source: Path  # the folder it was read from
    capture: Capture
    unit: float = 1.0  # world units per normalised unit, in which the near plane is given
    frame_rate: float | None = None  # of videos of cameras that stand still: frames per unit of time; None: others
    playback_rate: float | None = None  # of videos and clips: frames a second of rendered videos; None: frame_rate
    sweeps: tuple[Sweep, ...] = ()  # LiDAR of the training frames, in the order of time
    test_sweeps: tuple[Sweep, ...] = ()  # of the held-out frames; no model is trained on them
    metre: float | None = None  # world units per metre; None: unknown
    seconds_per_unit: float = 1.0  # of a driving log: seconds per unit of its times
    moving_by: str | None = None  # where the views' masks of what moves come from
    # Where cameras look at nothing in common: random initial points are drawn before them, at these depths
    init_depths: tuple[float, float] | None = None
    points: ScenePoints | None = None  # initial points; None: random, or from structure from motion
    test_split: str | None = None  # how the held-out views were chosen, for tables; None: as scene.test_split says

    @property
    def time_end(self) -> float:
        return self.time_start + self.duration

    @cached_property
    def _times_of_cameras(self) -> list[list[float]]:
        """The distinct times, ascending, of each training camera that films; of other photographs all in one list."""
        found: dict[str, set[float]] = defaultdict(set)
        for view in self.train:
            found[view.filmed_by].add(view.time)
        return [sorted(times) for times in found.values()]

    @cached_property
    def frame_spacing(self) -> float:
        """Mean difference of consecutive training times, in videos and logs of one camera's, as cameras need not be
        synchronised; the duration if there is only one time."""
        spacings = [(t[-1] - t[0]) / (len(t) - 1) for t in self._times_of_cameras if len(t) > 1]
        return statistics.mean(spacings) if spacings else self.duration  # exact for equal ones

    @property
    def frame_count(self) -> int:
        """The number of distinct training times, in videos of those of one camera."""
        return max(map(len, self._times_of_cameras))

    @property
    def has_seconds(self) -> bool:
        """Whether it is known how long it lasts: not of photographs."""
        return self.capture == "drive" or self.frame_rate is not None or self.playback_rate is not None

    @cached_property
    def clock(self) -> float:
        """Seconds per unit of its times, as played; 1 for photographs."""
        if self.capture == "drive":
            return self.seconds_per_unit
        if self.frame_rate is not None:
            return self.frame_rate / (self.playback_rate or self.frame_rate)
        if self.playback_rate is None:
            return 1.0
        times: dict[str, set[float]] = defaultdict(set)  # of a clip, held-out frames included
        for view in self.train + self.test:
            times[view.filmed_by].add(view.time)
        return max(1, max(map(len, times.values())) - 1) / (self.playback_rate * self.duration)

    @property
    def played_seconds(self) -> float | None:
        """How long a player shows it; None for photographs, which have no frame rate."""
        return self.duration * self.clock if self.has_seconds else None

    def seconds_at(self, time: float) -> float:
        """`time`, in seconds since the first one: as times are shown and given."""
        return (time - self.time_start) * self.clock

    def time_at(self, seconds: float) -> float:
        """The inverse of `seconds_at`."""
        return self.time_start + seconds / self.clock

    @property
    def several_cameras(self) -> bool:
        """Whether the training views show a moment from several places: always but for one camera, on a car or not."""
        if self.capture == "drive":
            return len(self._times_of_cameras) > 1
        return self.capture in ("static", "multi_view")


def capture_of(train: Sequence[View], test: Sequence[View], filmed: bool) -> Capture:
    """The capture of views that are not of a drive; filmed: each camera took its views in order of time."""
    times = {view.time for view in train}
    if len(times.union(view.time for view in test)) <= 1:
        return "static"
    if len({view.filmed_by for view in train}) > 1 or len(train) >= 2 * len(times):
        return "multi_view"
    return "clip" if filmed else "monocular"


def camera_extent(cameras: Sequence[Camera]) -> float:
    """3DGS's scene extent: 1.1 × the largest distance of a camera from their mean position, world units; of those that
    are no outliers (outliers.py)."""
    positions = without_outliers(np.stack([camera.position for camera in cameras]))
    distances = np.linalg.norm(positions - positions.mean(axis=0), axis=1)
    return EXTENT_MARGIN * float(distances.max())


def bounding_cube(points: np.ndarray, margin: float = 0.0) -> Box:
    """The axis-aligned cube around `points` (N, 3) but for outliers, enlarged by `margin` on every side."""
    points = without_outliers(points)
    low, high = np.min(points, axis=0), np.max(points, axis=0)
    middle, half = 0.5 * (low + high), 0.5 * float(np.max(high - low)) + margin
    return tuple((middle - half).tolist()), tuple((middle + half).tolist())


def make_camera(where: str | Path, make: Callable[[], Camera]) -> Camera:
    """make(), with the ValueError of invalid parameters turned into a SceneError that names the file."""
    try:
        return make()
    except ValueError as error:
        raise SceneError(where, "valid camera parameters", str(error)) from None


def validate_scene(scene: Scene) -> Scene:
    """Returns the scene unchanged, or raises SceneError if it cannot be trained on.

    Checks what every layout shares: views in both splits, one image size, images that fit their cameras, times in
    range, unique names, an extent above zero. Readers check what is specific to their layout.
    """
    for split, views in (("train", scene.train), ("test", scene.test)):
        if not views:
            raise SceneError(scene.source, f"at least one {split} view", "none")
    if not (0 < scene.duration < math.inf and math.isfinite(scene.time_start)):
        raise SceneError(
            scene.source, "a finite start and a duration > 0", f"start {scene.time_start}, duration {scene.duration}"
        )
    if scene.duration < MIN_DURATION:
        raise SceneError(scene.source, f"a duration of at least {MIN_DURATION:g}", f"{scene.duration:g}")
    if len(scene.background) != 3 or not all(0 <= channel <= 1 for channel in scene.background):
        raise SceneError(scene.source, "a background of three values in [0, 1]", f"{scene.background}")
    # Relative to the distance from the origin: rounding errors are no extent, but a rig of one metre is, also in map
    # coordinates of millions of metres.
    farthest = max(float(np.linalg.norm(view.camera.position)) for view in scene.train)
    if not scene.extent > max(1e-9 * farthest, SMALLEST_EXTENT):
        raise SceneError(
            scene.source,
            "training cameras at two places or more (from one no depth can be told)",
            f"{len(scene.train)} at one place: a panorama, or camera-to-world and world-to-camera exchanged",
        )
    if not (
        np.isfinite(np.concatenate([np.ravel(corner) for corner in scene.init_box])).all()
        and np.less(*scene.init_box).all()
    ):
        raise SceneError(scene.source, "init_box [low, high] with low < high", f"{scene.init_box}")
    if not 0 < scene.unit < math.inf:
        raise SceneError(scene.source, "a unit > 0", f"{scene.unit}")

    first = scene.train[0]
    names: set[str] = set()
    for view in scene.train + scene.test:
        _validate_view(view, scene, first)
        if view.name in names:
            both = {view.name} <= {v.name for v in scene.train} & {v.name for v in scene.test}
            found = "in the training and the test split: leave it out of one" if both else "twice"
            raise SceneError(scene.source, "each view's name once", f"{view.name} {found}")
        names.add(view.name)

    for sweep in scene.sweeps + scene.test_sweeps:
        _validate_sweep(sweep, scene)

    return scene


def _validate_view(view: View, scene: Scene, first: View) -> None:
    where = scene.source / view.name
    shape = (view.camera.height, view.camera.width, 3)
    if view.image.dtype != np.uint8 or view.image.shape != shape:
        raise SceneError(
            where, f"an image of uint8 {shape}, its camera's size", f"{view.image.dtype} {view.image.shape}"
        )
    if view.image.shape != first.image.shape and scene.capture != "drive":
        raise SceneError(
            where,
            f"{first.camera.width} x {first.camera.height} pixels as {first.name}",
            f"{view.camera.width} x {view.camera.height}",
        )
    if not scene.time_start <= view.time <= scene.time_end:  # also false for NaN
        raise SceneError(where, f"a time in [{scene.time_start:g}, {scene.time_end:g}]", f"{view.time}")
    for name, mask in (("sky", view.sky), ("moving", view.moving)):
        if mask is not None and (mask.dtype != np.bool_ or mask.shape != shape[:2]):
            raise SceneError(where, f"a {name} mask of bool {shape[:2]}", f"{mask.dtype} {mask.shape}")


def _validate_sweep(sweep: Sweep, scene: Scene) -> None:
    where = f"{scene.source}: sweep of frame {sweep.frame}"
    if not scene.time_start <= sweep.time <= scene.time_end:
        raise SceneError(where, f"a time in [{scene.time_start:g}, {scene.time_end:g}]", f"{sweep.time}")
    if not (np.isfinite(sweep.points).all() and np.isfinite(sweep.origin).all()):
        raise SceneError(where, "finite points", "NaN or Inf")
