"""Reads a folder in the D-NeRF (Blender) layout, and what COLMAP-to-NeRF converters make of photographs.

    DIR/transforms_train.json, transforms_val.json, transforms_test.json
        {"camera_angle_x": horizontal field of view in radians,
         "frames": [{"file_path": "./train/r_0", "time": 0.0 … 1.0, "transform_matrix": 4×4 camera-to-world}, …]}
    DIR/train/r_0.png …   RGB or RGBA with straight alpha, all of one size

Intrinsics may be in pixels and lenses distorted (intrinsics.py). A single transforms.json, as converters write it, is
taken for transforms_train.json. Without `time` in any frame the scene is static. Times may be in any other unit too:
frames, seconds, since 1970. Poses have Blender's camera axes (x right, y up, z backward).
Every fault is a `SceneError`, raised before an image is decoded where the headers suffice to see it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from datasets.cameras.intrinsics import intrinsics_of, read_lens, read_pinhole
from datasets.cameras.transforms import find_image, load_transforms, read_pose
from datasets.canonical import canonical_space
from datasets.composition import BLACK, WHITE, Color, border_color, compose, coverage
from datasets.files.image_files import common_size, read_rgba
from datasets.files.json_values import get_key, read_number
from datasets.scene import Scene, SceneError, View, camera_extent, camera_of, validate_scene
from rasterizer.camera import Camera

# Times that lie in [0, 1] and span more of it than this are the layout's own.
LEAST_SPAN = 0.5
# A first or last time that does not go on as the others do is a slip, and would leave them a part of the scene's time.
REGULAR = (0.75, 1.5)  # × the longest step between the others, where these lie in [0, 1]
STRAY = 10.0  # × all that the others span, in any other unit
SPLITS = ("train", "test", "val")
HELD_OUT_EVERY = 8  # what a message offers where no split is held out


@dataclass(frozen=True)
class Frame:
    """One entry of a transforms file, checked."""

    name: str  # "train/r_0"
    where: str  # "DIR/transforms_train.json: frames[0]", for messages
    file: Path  # the transforms file
    image_path: Path
    time: float | None
    cam_to_world: np.ndarray  # (4, 4), Blender axes
    intrinsics: dict[str, Any]  # see intrinsics.py


def read_dnerf(
    path: str | Path,
    *,
    name: str,
    test_split: str | None = "test",
    downscale: int = 2,
    background: Color | None = BLACK,
    init_box: tuple[float, float] = (-1.2, 1.2),
    log: Callable[[str], None] = lambda line: None,
) -> Scene:
    """The scene in folder `path`.

    test_split: the held-out split, "test" or "val" (the paper tests lego on val). None: none is read, and `Scene.test`
    is empty: the caller holds out training views (validation.py).
    downscale: images are read at 1/downscale of their size, by area average (see compose).
    background: RGB in [0, 1], composed under transparent pixels exactly once. None: what the borders of opaque training
    images show if they are of one colour, else black.
    init_box: [low, high] of the cube that random points start in, canonical units (canonical.py): nothing in this
    layout says how far a scene reaches.
    log: takes a line of text for the user.
    Raises SceneError for anything that is not as the layout promises.
    """
    root = Path(path)
    if not root.is_dir():
        raise SceneError(root, "a folder in the D-NeRF layout", "a file" if root.exists() else "nothing there")
    frames = {"train": _read_transforms(root, "train")}
    if test_split is not None:
        frames[test_split] = _read_transforms(root, test_split)
    everything = [frame for split in frames.values() for frame in split]
    time_start, duration = _time_range(root, everything)
    size = common_size([frame.image_path for frame in everything])
    if min(size) < downscale:
        raise SceneError(
            everything[0].image_path, f"at least {downscale} pixels a side (downscale)", "{} x {}".format(*size)
        )

    lenses = {frame.name: _read_lens(frame, size) for frame in everything}  # before any image is decoded
    composed_over = BLACK if background is None else tuple(float(channel) for channel in background)
    views = {
        split: tuple(_read_view(frame, size, downscale, composed_over, *lenses[frame.name]) for frame in found)
        for split, found in frames.items()
    }
    shown = _background(views["train"], background, log)
    cameras = [view.camera for view in views["train"]]
    space = canonical_space(cameras)
    scene = Scene(
        name=name,
        train=views["train"],
        test=views[test_split] if test_split else (),
        duration=duration,
        time_start=time_start,
        background=shown,
        extent=camera_extent(cameras),
        init_box=space.inverse.box(tuple(init_box)),
        source=root,
        unit=space.unit,
    )
    return validate_scene(scene) if test_split else scene


def has_split(path: str | Path, split: str) -> bool:
    """Whether the folder has a transforms file for `split`."""
    return (Path(path) / f"transforms_{split}.json").is_file()


def _background(views: Sequence[View], asked: Color | None, log: Callable[[str], None]) -> Color:
    """`asked`; where that is None, the colour of the borders of images that have no alpha, or else black."""
    opaque = all(view.coverage is None for view in views)
    found = border_color([np.asarray(view.image) for view in views]) if opaque else None
    if asked is None:
        if found not in (None, BLACK):
            log(
                f"scene.background: {_named(found)}, the colour of the images' borders; "
                "scene.background=black overrides"
            )
        return found or BLACK
    asked = tuple(float(channel) for channel in asked)
    if found is not None and found != asked:
        log(f"scene.background: {_named(asked)}, as asked for, though the images' borders are {_named(found)}")
    return asked


def _named(color: Color) -> str:
    names = {BLACK: "black", WHITE: "white"}
    return names.get(color) or "[" + ",".join(f"{channel:.3g}" for channel in color) + "]"


def _read_transforms(root: Path, split: str) -> list[Frame]:
    path = root / f"transforms_{split}.json"
    if split == "train" and not path.exists() and (root / "transforms.json").is_file():
        path = root / "transforms.json"
    elif not path.exists():
        raise SceneError(path, "a file (D-NeRF layout)", _instead(root, split))
    content, entries = load_transforms(path)
    return [_read_frame(entry, content, f"{path}: frames[{index}]", path, root) for index, entry in enumerate(entries)]


def _instead(root: Path, split: str) -> str:
    """ "none", and which key makes do without this split."""
    if split == "train":
        return "none"
    others = [other for other in SPLITS if other not in ("train", split) and has_split(root, other)]
    taken = [f"transforms_{other}.json is there: scene.test_split={other} takes it" for other in others]
    every = f"scene.validation_every={HELD_OUT_EVERY} holds out every eighth training view"
    return "; ".join(["none", *taken, every])


def _read_frame(entry: Any, content: dict, where: str, file: Path, root: Path) -> Frame:
    file_path, image_path = find_image(entry, where, root)
    time = None
    if "time" in entry:
        time = read_number(entry["time"], f"{where}: time")
        if not math.isfinite(time):
            raise SceneError(f"{where}: time", "a finite time", f"{time}")
    pose = read_pose(get_key(entry, "transform_matrix", where), f"{where}: transform_matrix")
    return Frame(
        Path(file_path).as_posix().removesuffix(".png"),
        where,
        file,
        image_path,
        time,
        pose,
        intrinsics_of(content, entry),
    )


def _time_range(root: Path, frames: list[Frame]) -> tuple[float, float]:
    """(start, duration): [0, 1] for times as the layout has them and for none; else from the first time to the last.

    All frames are timed or none is: a frame without its time must not pass for time zero.
    """
    missing = [frame.name for frame in frames if frame.time is None]
    if missing and len(missing) < len(frames):
        raise SceneError(
            root / missing[0],
            "a time in every frame or in none",
            f"none here and in {len(missing)} of {len(frames)} frames",
        )
    if missing:
        return 0.0, 1.0
    ordered = sorted(frames, key=lambda frame: frame.time)
    low, high = ordered[0].time, ordered[-1].time
    if low >= 0 and high <= 1 and (high - low > LEAST_SPAN or high == low):
        return 0.0, 1.0
    for stray, others in ((ordered[0], ordered[1:]), (ordered[-1], ordered[:-1])) if len(ordered) > 1 else ():
        times = [frame.time for frame in others]
        steps, gap = np.diff(times), min(abs(stray.time - time) for time in times)
        own = times[0] >= 0 and times[-1] <= 1  # the layout's range
        step = steps.max(initial=0)
        regular = REGULAR[0] * step < gap < REGULAR[1] * step if own else gap < STRAY * (times[-1] - times[0])
        if gap > 0 and step > 0 and not regular:
            raise SceneError(
                root / stray.name,
                "a time in [0, 1], as the other frames have"
                if own
                else f"a time near the other frames', {times[0]:.13g} to {times[-1]:.13g}",
                f"{stray.time:.13g}",
            )
    duration = high - low or 1.0
    while low + duration < high:  # by rounding
        duration = math.nextafter(duration, math.inf)
    return low, duration


def _read_lens(frame: Frame, size: tuple[int, int]) -> tuple[Camera, tuple[float, ...]]:
    """The camera of the whole image, and its lens's distortion (empty: none)."""
    camera = read_pinhole(frame.intrinsics, size, frame.cam_to_world, frame.where, frame.file)
    distortion = read_lens(frame.intrinsics, frame.where)
    return camera, distortion if any(distortion) else ()


def _read_view(
    frame: Frame, size: tuple[int, int], downscale: int, background: Color, whole: Camera, distortion: tuple[float, ...]
) -> View:
    rgba = read_rgba(frame.image_path)
    width, height = size
    if rgba.shape[:2] != (height, width):
        raise SceneError(
            frame.image_path, f"{width} x {height} pixels as its header says", "{1} x {0}".format(*rgba.shape)
        )
    if distortion:
        from datasets.cameras.lens import Undistortion, straighten_rgba  # OpenCV, which other scenes do without

        rgba = straighten_rgba(rgba, Undistortion.of(whole, *distortion).maps(size))
    small = compose(rgba, background, downscale)

    def camera() -> Camera:
        # First the part of the image that `compose` kept (intrinsics in pixels from the top left stay), then its scale.
        kept = replace(whole, width=small.shape[1] * downscale, height=small.shape[0] * downscale)
        return kept.resized(small.shape[1], small.shape[0])

    return View(camera_of(frame.image_path, camera), frame.time or 0.0, small, frame.name, coverage(rgba, downscale))
