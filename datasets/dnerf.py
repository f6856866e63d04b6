"""Reads a folder in the D-NeRF (Blender) layout.

    DIR/transforms_train.json, transforms_val.json, transforms_test.json
        {"camera_angle_x": horizontal field of view in radians,
         "frames": [{"file_path": "./train/r_0", "time": 0.0 … 1.0, "transform_matrix": 4×4 camera-to-world}, …]}
    DIR/train/r_0.png …   RGB or RGBA with straight alpha, all of one size

Without `time` in any frame the scene is static. Times may be in any other unit too: frames, seconds, since 1970. Poses
have Blender's camera axes (x right, y up, z backward).
Every fault is a `SceneError`, raised before an image is decoded where the headers suffice to see it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from datasets.canonical import canonical_space
from datasets.fault import read_json
from datasets.scene import Scene, SceneError, View, camera_extent, camera_of, validate_scene
from rasterizer.camera import FARTHEST, Camera

# RᵀR may differ from I by this much: D-NeRF stores float32 (2e-7), files rounded to four decimals reach 1e-4.
RIGID_TOLERANCE = 1e-3
SMALLEST_ANGLE = 1e-6  # radians; a telescope sees 1e-3

# Times that lie in [0, 1] and span more of it than this are the layout's own.
LEAST_SPAN = 0.5
# A first or last time that does not go on as the others do is a slip, and would leave them a part of the scene's time.
REGULAR = (0.75, 1.5)  # × the longest step between the others, where these lie in [0, 1]
STRAY = 10.0  # × all that the others span, in any other unit


@dataclass(frozen=True)
class Frame:
    """One entry of a transforms file, checked."""

    name: str  # "train/r_0"
    image_path: Path
    time: float | None
    cam_to_world: np.ndarray  # (4, 4), Blender axes
    angle_x: float  # radians


def read_dnerf(path: str | Path, *, name: str, test_split: str = "test", downscale: int = 2,
               background: tuple[float, float, float] = (0.0, 0.0, 0.0),
               init_box: tuple[float, float] = (-1.2, 1.2)) -> Scene:
    """The scene in folder `path`.

    test_split: the held-out split, "test" or "val" (the paper tests lego on val).
    downscale: images are read at 1/downscale of their size, by area average (see compose).
    background: RGB in [0, 1], composed under transparent pixels exactly once.
    init_box: [low, high] of the cube that random points start in, canonical units (canonical.py): nothing in this
    layout says how far a scene reaches.
    Raises SceneError for anything that is not as the layout promises.
    """
    root = Path(path)
    if not root.is_dir():
        raise SceneError(root, "a folder in the D-NeRF layout", "a file" if root.exists() else "nothing there")
    frames = {split: _read_transforms(root, split) for split in ("train", test_split)}
    everything = [frame for split in frames.values() for frame in split]
    time_start, duration = _time_range(root, everything)
    size = common_size([frame.image_path for frame in everything])
    if min(size) < downscale:
        raise SceneError(everything[0].image_path, f"at least {downscale} pixels a side (downscale)",
                         "{} x {}".format(*size))

    background = tuple(float(channel) for channel in background)
    views = {split: tuple(_read_view(frame, size, downscale, background) for frame in found)
             for split, found in frames.items()}
    cameras = [view.camera for view in views["train"]]
    space = canonical_space(cameras)
    scene = Scene(name=name, train=views["train"], test=views[test_split], duration=duration, time_start=time_start,
                  background=background, extent=camera_extent(cameras), init_box=space.inverse.box(tuple(init_box)),
                  source=root, unit=space.unit)
    return validate_scene(scene)


def compose(rgba: np.ndarray, background: tuple[float, float, float], downscale: int = 1) -> np.ndarray:
    """An RGBA image with straight alpha (H, W, 4) uint8 over `background`, averaged over downscale² pixels.

    Premultiplied colour and alpha are averaged, then composed, then rounded once; both steps being linear, this is
    composing at full size and averaging that. Averaging straight colour instead would let the colour that hides
    under transparent pixels leak into the edges. Rows and columns at the end that fill no block are left out.
    Returns (H // downscale, W // downscale, 3) uint8.
    """
    alpha = rgba[..., 3].astype(np.float32) / 255
    see_through = 255 * (1 - _block_means(alpha, downscale))
    # One channel at a time: numpy is several times faster on planes than on interleaved pixels.
    channels = [_block_means(rgba[..., c] * alpha, downscale) + np.float32(background[c]) * see_through for c in range(3)]
    return np.rint(np.stack(channels, axis=-1)).astype(np.uint8)


def coverage(rgba: np.ndarray, downscale: int = 1) -> np.ndarray | None:
    """How much of each pixel of `compose`'s image is not background, (H, W) uint8; None where nothing is background."""
    alpha = rgba[..., 3]
    return None if alpha.min() == 255 else np.rint(_block_means(alpha.astype(np.float32), downscale)).astype(np.uint8)


def _block_means(plane: np.ndarray, side: int) -> np.ndarray:
    """Means (H // side, W // side) of the whole side × side blocks of (H, W)."""
    plane = plane[:plane.shape[0] // side * side, :plane.shape[1] // side * side]
    return sum(plane[i::side, j::side] for i in range(side) for j in range(side)) / np.float32(side**2)


def _read_transforms(root: Path, split: str) -> list[Frame]:
    path = root / f"transforms_{split}.json"
    content, entries = load_transforms(path)
    angle_x = read_angle_x(content, path)
    return [_read_frame(entry, f"{path}: frames[{index}]", root, angle_x) for index, entry in enumerate(entries)]


def load_transforms(path: Path) -> tuple[dict, list]:
    """A transforms file's content, and the list of its frames: one at least."""
    try:
        content = read_json(path, SceneError)
    except FileNotFoundError:
        raise SceneError(path, "a file (D-NeRF layout)", "none") from None
    if not isinstance(content, dict):
        raise SceneError(path, "an object with camera_angle_x and frames", type(content).__name__)
    entries = get_key(content, "frames", path)
    if not isinstance(entries, list) or not entries:
        raise SceneError(f"{path}: frames", "a list of at least one frame", "an empty list" if entries == [] else
                         type(entries).__name__)
    return content, entries


def read_angle_x(content: dict, path: Path) -> float:
    """The horizontal field of view, radians."""
    angle_x = read_number(get_key(content, "camera_angle_x", path), f"{path}: camera_angle_x")
    if not SMALLEST_ANGLE <= angle_x < math.pi:
        raise SceneError(f"{path}: camera_angle_x", f"an angle in (0, π) radians, {SMALLEST_ANGLE:g} at least",
                         f"{angle_x}")
    return angle_x


def _read_frame(entry: Any, where: str, root: Path, angle_x: float) -> Frame:
    file_path, image_path = find_image(entry, where, root)
    time = None
    if "time" in entry:
        time = read_number(entry["time"], f"{where}: time")
        if not math.isfinite(time):
            raise SceneError(f"{where}: time", "a finite time", f"{time}")
    pose = read_pose(get_key(entry, "transform_matrix", where), f"{where}: transform_matrix")
    return Frame(Path(file_path).as_posix().removesuffix(".png"), image_path, time, pose, angle_x)


def find_image(entry: Any, where: str, root: Path) -> tuple[str, Path]:
    """The file_path of an entry of `frames`, as it stands there, and the file it names."""
    if not isinstance(entry, dict):
        raise SceneError(where, "an object", type(entry).__name__)
    file_path = get_key(entry, "file_path", where)
    if not isinstance(file_path, str) or not Path(file_path).name:
        raise SceneError(f"{where}: file_path", "a file name", repr(file_path))
    image_path = root / file_path
    if not _is_file(image_path) and image_path.suffix.lower() != ".png":
        image_path = image_path.with_name(image_path.name + ".png")  # D-NeRF leaves it out
    if not _is_file(image_path):
        raise SceneError(image_path, f"an image, named by {where}", "no such file")
    return file_path, image_path


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a name that is too long, a folder that may not be entered
        return False


def read_pose(value: Any, where: str) -> np.ndarray:
    """(4, 4) float64, rigid."""
    try:
        pose = np.array(value)
        if pose.dtype.kind not in "fiuO":  # O: integers too large for numpy's; text is no number
            raise TypeError
        pose = pose.astype(np.float64)
    except (TypeError, ValueError, OverflowError, RecursionError):
        raise SceneError(where, "4 x 4 numbers", "ragged rows or something not a number") from None
    if pose.shape != (4, 4):
        raise SceneError(where, "4 x 4 numbers", f"shape {pose.shape}")
    if not np.isfinite(pose).all():
        raise SceneError(where, "finite numbers", "NaN or Inf")
    rotation, position = pose[:3, :3], pose[:3, 3]
    error = float(np.abs(rotation.T @ rotation - np.eye(3)).max()) if np.abs(rotation).max() <= 2 else math.inf
    determinant = np.linalg.det(rotation) if error < math.inf else math.nan
    if not (error <= RIGID_TOLERANCE and determinant > 0 and np.abs(pose[3] - [0, 0, 0, 1]).max() <= RIGID_TOLERANCE):
        raise SceneError(where, "a rigid pose (a rotation, last row 0 0 0 1)",
                         f"|RᵀR - I| up to {error:.2g}, det R {determinant:.3g}, last row {pose[3].tolist()}")
    if np.abs(position).max() > FARTHEST:
        raise SceneError(where, f"a position within {FARTHEST:g} of the origin", f"{position.tolist()}")
    pose[3] = 0, 0, 0, 1
    return pose


def _time_range(root: Path, frames: list[Frame]) -> tuple[float, float]:
    """(start, duration): [0, 1] for times as the layout has them and for none; else from the first time to the last.

    All frames are timed or none is: a frame without its time must not pass for time zero.
    """
    missing = [frame.name for frame in frames if frame.time is None]
    if missing and len(missing) < len(frames):
        raise SceneError(root / missing[0], "a time in every frame or in none",
                         f"none here and in {len(missing)} of {len(frames)} frames")
    if missing:
        return 0.0, 1.0
    ordered = sorted(frames, key=lambda frame: frame.time)
    low, high = ordered[0].time, ordered[-1].time
    if 0 <= low and high <= 1 and (high - low > LEAST_SPAN or high == low):
        return 0.0, 1.0
    for stray, others in ((ordered[0], ordered[1:]), (ordered[-1], ordered[:-1])):
        times = [frame.time for frame in others]
        steps, gap = np.diff(times), min(abs(stray.time - time) for time in times)
        own = times[0] >= 0 and times[-1] <= 1  # the layout's range
        step = steps.max(initial=0)
        regular = REGULAR[0] * step < gap < REGULAR[1] * step if own else gap < STRAY * (times[-1] - times[0])
        if gap > 0 and step > 0 and not regular:
            raise SceneError(root / stray.name, "a time in [0, 1], as the other frames have" if own else
                             f"a time near the other frames', {times[0]:.13g} to {times[-1]:.13g}", f"{stray.time:.13g}")
    duration = high - low or 1.0
    while low + duration < high:  # by rounding
        duration = math.nextafter(duration, math.inf)
    return low, duration


def common_size(paths: Sequence[Path]) -> tuple[int, int]:
    """(width, height) of all images, from their headers."""
    sizes = []
    for path in paths:
        try:
            with Image.open(path) as image:
                sizes.append(image.size)
        except Exception as error:  # PIL raises many types for broken files
            raise SceneError(path, "a readable image", str(error)) from None
        if sizes[-1] != sizes[0]:
            raise SceneError(path, "{} x {} pixels as {}".format(*sizes[0], paths[0].name),
                             "{} x {}".format(*sizes[-1]))
    return sizes[0]


def read_rgba(path: Path) -> np.ndarray:
    """(H, W, 4) uint8, straight alpha; 255 where the file has none."""
    try:
        with Image.open(path) as image:
            mode = image.mode
            rgba = np.asarray(image.convert("RGBA"))
    except Exception as error:  # a truncated file shows only now
        raise SceneError(path, "a readable image", str(error)) from None
    if mode.startswith(("I", "F")):
        raise SceneError(path, "8 bits a channel", f"image mode {mode}")
    return rgba


def _read_view(frame: Frame, size: tuple[int, int], downscale: int, background: tuple[float, float, float]) -> View:
    rgba = read_rgba(frame.image_path)
    width, height = size
    if rgba.shape[:2] != (height, width):
        raise SceneError(frame.image_path, f"{width} x {height} pixels as its header says",
                         "{1} x {0}".format(*rgba.shape))
    small = compose(rgba, background, downscale)

    def camera() -> Camera:
        whole = Camera.from_blender(width, height, 0.5 * width / math.tan(0.5 * frame.angle_x), frame.cam_to_world)
        # First the part of the image that `compose` kept (intrinsics in pixels from the top left stay), then its scale.
        kept = replace(whole, width=small.shape[1] * downscale, height=small.shape[0] * downscale)
        return kept.resized(small.shape[1], small.shape[0])

    return View(camera_of(frame.image_path, camera), frame.time or 0.0, small, frame.name,
                coverage(rgba, downscale))


def get_key(container: dict, key: str, where: str | Path) -> Any:
    if key not in container:
        raise SceneError(where, f"the key {key}", f"only {', '.join(container) or 'nothing'}")
    return container[key]


def read_number(value: Any, where: str, largest: float | None = None) -> float:
    """A float, within ±largest; where that is None NaN and infinity too."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise SceneError(where, "a number", repr(value))
    try:
        number = float(value)
    except OverflowError:
        raise SceneError(where, "a number below 1.8e308", "a larger one") from None
    if largest is not None and not abs(number) <= largest:
        raise SceneError(where, f"a number within ±{largest:g}", f"{number}")
    return number
