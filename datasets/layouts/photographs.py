"""Photographs with cameras and times, as any layout describes them, and the `Scene` that they make.

Images are read when they are first used, so that memory does not grow with a folder of thousands: only their headers
are read here, those with alpha, and a few for the background.
"""

from __future__ import annotations

import os
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from datasets.cameras.lens import Lens, both, imaged, undistort, undistort_rgba
from datasets.canonical import canonical_space
from datasets.composition import BLACK, Color, chosen_background, chosen_downscale, compose, coverage, reduced_camera
from datasets.files.errors import SceneError
from datasets.files.image_files import common_size, has_alpha, is_file, read_rgba
from datasets.files.natural_order import natural_order
from datasets.scene import PLAYBACK_RATE, Scene, ScenePoints, View, camera_extent, make_camera, validate_scene
from rasterizer.camera import MAX_DISTANCE, Camera

KEPT_BYTES = 1 << 30  # of decoded images, which are then kept; more are read again at each use
FEWEST = 3  # photographs
BORDER_IMAGES = 12  # evenly spread training images whose borders are looked at
GREY = 128  # of 255

Log = Callable[[str], None]


@dataclass(frozen=True)
class LayoutOptions:
    """How a folder is read: settings of SceneConfig."""

    name: str  # of the scene
    downscale: int = 0  # 0: chosen, see composition.chosen_downscale
    test_every: int = 8  # where the layout has no test split
    test_cameras: Sequence[int] = (0,)  # where several cameras filmed
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
    folder: str = ""  # of the physical camera's images, where it has one of its own, or the beginning of their names


class FileImage:
    """Pixels (H, W, 3) uint8 of a photograph, read when needed; `np.asarray` reads them."""

    dtype = np.dtype(np.uint8)

    def __init__(self, photograph: Photograph, shape: tuple[int, int, int], downscale: int, background: Color) -> None:
        self.shape: tuple[int, ...] = shape
        self._photograph, self._downscale, self._background = photograph, downscale, background
        self.keep = False
        self._pixels: np.ndarray | None = None

    def __array__(self, dtype: np.dtype | None = None, copy: bool | None = None) -> np.ndarray:
        image = self._pixels if self._pixels is not None else self._read()
        if self.keep:
            self._pixels = image
        return image if dtype is None else image.astype(dtype, copy=False)

    def _read(self) -> np.ndarray:
        return compose(_undistorted(self._photograph), self._background, self._downscale)


def by_folder(photographs: Sequence[Photograph]) -> list[Photograph]:
    """images/left/1.png, images/right/1.png: a camera for each folder, numbered in the order of the folders' names.

    In one folder, left_1.png and right_1.png: a camera for each beginning of the names, if each stands still.
    """
    parents = [os.path.abspath(photograph.path.parent) for photograph in photographs]
    folders = sorted(set(parents), key=natural_order)
    if len(folders) < 2:
        return _by_beginning(photographs)
    names = [os.path.relpath(folder, os.path.commonpath(folders)) for folder in folders]
    groups = {folder: group for group, folder in enumerate(folders)}
    return [replace(p, group=groups[own], folder=names[groups[own]]) for p, own in zip(photographs, parents)]


def _by_beginning(photographs: Sequence[Photograph]) -> list[Photograph]:
    beginnings = [re.sub(r"[\W_]*\d+$", "", photograph.path.stem) for photograph in photographs]
    numbers = {name: number for number, name in enumerate(sorted(set(beginnings), key=natural_order))}
    found = [replace(p, group=numbers[own], folder=own) for p, own in zip(photographs, beginnings)]
    return found if _stand_still(found) else list(photographs)


def to_scene(
    root: Path, photographs: Sequence[Photograph], options: LayoutOptions, points: ScenePoints | None = None
) -> Scene:
    """The scene of photographs in any order. SceneError where they do not make one."""
    photographs = _timed(sorted(photographs, key=lambda photograph: natural_order(photograph.name)), options)
    if len(photographs) < FEWEST:
        raise SceneError(root, f"at least {FEWEST} photographs with a camera", f"{len(photographs)}")
    photographs = _limited(root, photographs, options)
    (name, count), *_ = Counter(photograph.name for photograph in photographs).most_common(1)
    if count > 1:
        raise SceneError(root, "each photograph once", f"{name} {count} times")
    size = common_size([photograph.path for photograph in photographs])
    for photograph in photographs:
        if (photograph.camera.width, photograph.camera.height) != size:
            raise SceneError(
                photograph.path,
                f"{photograph.camera.width} x {photograph.camera.height} pixels, as its camera",
                "{} x {}".format(*size),
            )
    downscale = options.downscale or chosen_downscale(size)
    if min(size) < downscale:
        raise SceneError(root, f"at least {downscale} pixels a side (scene.downscale)", "{} x {}".format(*size))
    held_out, how = _held_out(root, photographs, options)
    options.log(f"held out: {how}")
    trained = [photograph for photograph in photographs if photograph.name not in held_out]
    composed_over = options.background or BLACK
    views: dict[str, list[View]] = {"train": [], "test": []}
    cameras: dict[int, Camera] = {}
    for photograph in photographs:
        split = "test" if photograph.name in held_out else "train"
        small = cameras.setdefault(
            id(photograph.camera), make_camera(photograph.path, partial(reduced_camera, photograph.camera, downscale))
        )
        image = FileImage(photograph, (small.height, small.width, 3), downscale, composed_over)
        image.keep = len(photographs) * 3 * small.width * small.height <= KEPT_BYTES
        assert photograph.time is not None
        alpha = coverage(_undistorted(photograph), downscale) if has_alpha(photograph.path) else None
        name, full = f"{split}/{photograph.name}", photograph.camera
        seen = imaged(photograph.lens, (full.width, full.height), (small.width, small.height))
        mask = both(_mask(photograph, downscale), seen)
        views[split].append(View(small, photograph.time, image, name, alpha, mask=mask))
    train_cameras = [view.camera for view in views["train"]]
    background = _background(views["train"], options)
    space = canonical_space(train_cameras)
    times = [photograph.time for photograph in photographs if photograph.time is not None]
    low, high = min(times), max(times)
    duration = high - low or 1.0
    while low + duration < high:  # rounding
        duration = float(np.nextafter(duration, np.inf))
    return validate_scene(
        Scene(
            name=options.name,
            train=tuple(views["train"]),
            test=tuple(views["test"]),
            duration=duration,
            time_start=low,
            background=background,
            extent=camera_extent(train_cameras),
            init_box=space.inverse.box((-1.2, 1.2)),
            source=root,
            unit=space.unit,
            playback_rate=PLAYBACK_RATE if len({p.group for p in trained}) == 1 and high > low else None,
            cameras_stand=_stand_still(trained),
            points=points,
            test_split=how,
        )
    )


def scene_points(positions: np.ndarray, colors: np.ndarray | None = None) -> ScenePoints | None:
    """(N, 3) positions and colours of 0 to 255, grey without; what is no place in a scene is left out. None if all are.

    Any type of numbers.
    """
    with np.errstate(all="ignore"):
        good = (np.abs(positions) <= MAX_DISTANCE).all(axis=1)  # NaN is no place
        if colors is None:
            colors = np.full(positions.shape, GREY)
        colors = np.nan_to_num(np.clip(colors[good], 0, 255), nan=GREY).round().astype(np.uint8)
    return ScenePoints(positions[good].astype(np.float64), colors) if good.any() else None


def _undistorted(photograph: Photograph) -> np.ndarray:
    """(H, W, 4) uint8 of the file at full size, with straight alpha."""
    rgba = read_rgba(photograph.path)
    width, height = photograph.camera.width, photograph.camera.height
    if rgba.shape[:2] != (height, width):
        raise SceneError(photograph.path, f"{width} x {height} pixels, as its camera", "{1} x {0}".format(*rgba.shape))
    return undistort_rgba(rgba, photograph.lens.maps((width, height))) if photograph.lens else rgba


def _background(views: Sequence[View], options: LayoutOptions) -> Color:
    """By scene.background; auto: of opaque images, the border colour of BORDER_IMAGES of them."""
    if any(view.coverage is not None for view in views):
        return chosen_background([], False, options.background, options.log)
    chosen = np.unique(np.linspace(0, len(views) - 1, BORDER_IMAGES).round().astype(int))
    images = [np.asarray(views[index].image) for index in chosen]
    return chosen_background(images, True, options.background, options.log)


def _timed(photographs: Sequence[Photograph], options: LayoutOptions) -> list[Photograph]:
    """All with a time, ascending: the layout's, else the numbers in the names, else evenly spaced.

    Numbers are times if no camera has one twice; cameras in folders of their own count alike.
    """
    known = [photograph.time for photograph in photographs if photograph.time is not None]
    if known and len(known) < len(photographs):
        missing = next(photograph for photograph in photographs if photograph.time is None)
        raise SceneError(missing.path, "a time in every frame or in none", f"none here and {len(known)} elsewhere")
    if known:
        return sorted(photographs, key=lambda p: (p.time, p.name))
    numbers = [_last_number(photograph.path.stem) for photograph in photographs]
    of_cameras = {(photograph.group, number) for photograph, number in zip(photographs, numbers)}
    if None not in numbers and len(of_cameras) == len(numbers) and len(set(numbers)) > 1:
        times, how = [number for number in numbers if number is not None], "the numbers in the file names"
    else:
        times, how = [float(index) for index in range(len(photographs))], "evenly spaced, in the order of the names"
    options.log(f"times: {how}; if nothing moves, ablation.static=true leaves time out")
    return sorted((replace(p, time=t) for p, t in zip(photographs, times)), key=lambda p: p.time or 0.0)


def _limited(root: Path, photographs: Sequence[Photograph], options: LayoutOptions) -> list[Photograph]:
    """Those of at most options.frames different times, evenly spread, from options.first_frame on.

    SceneError for settings that leave fewer than FEWEST.
    """
    times = sorted({photograph.time for photograph in photographs if photograph.time is not None})
    rest = [photograph for photograph in photographs if photograph.time in set(times[options.first_frame :])]
    if _stand_still(rest):
        found = [p for group in sorted({p.group for p in rest}) for p in _spread(rest, options.frames, group)]
        found.sort(key=lambda p: (p.time, p.name))
    else:
        found = _spread(rest, options.frames)
    if len(found) < len(rest):
        used = len({photograph.time for photograph in found})
        options.log(f"{used} of {len(times)} times are used, evenly spread (scene.frames={options.frames})")
    if len(found) < FEWEST:
        cut = len(times) - options.first_frame > options.frames
        key, value = ("frames", options.frames) if cut else ("first_frame", options.first_frame)
        raise SceneError(
            f"{root}: scene.{key}",
            f"a number that leaves at least {FEWEST} of {len(photographs)} photographs of {len(times)} times",
            f"{value}, which leaves {len(found)}",
        )
    return found


def _spread(photographs: Sequence[Photograph], count: int, group: int | None = None) -> list[Photograph]:
    """Those of at most `count` times, evenly spread; of one group or all.

    Times that the layout holds out are spread by themselves: of times that alternate, an even choice from both would
    train on one stretch and test on another.
    """
    own = [photograph for photograph in photographs if group is None or photograph.group == group]
    times = {photograph.time for photograph in own}
    trained = {photograph.time for photograph in own if not photograph.test}
    if len(times) <= count:
        return own
    of_training = round(count * len(trained) / len(times))
    kept = {
        listed[i]
        for chosen, number in ((trained, of_training), (times - trained, count - of_training))
        if (listed := sorted(time for time in chosen if time is not None))
        for i in np.linspace(0, len(listed) - 1, max(1, number)).round().astype(int)
    }
    return [photograph for photograph in own if photograph.time in kept]


def _stand_still(photographs: Sequence[Photograph]) -> bool:
    """Whether they are by two cameras or more, each of which took several from one place."""
    poses: dict[int, set[bytes]] = defaultdict(set)
    for photograph in photographs:
        poses[photograph.group].add(photograph.camera.world_to_cam.tobytes())
    fewest = min(Counter(photograph.group for photograph in photographs).values(), default=0)
    return len(poses) > 1 and fewest > 1 and all(len(found) == 1 for found in poses.values())


def _held_out(root: Path, photographs: Sequence[Photograph], options: LayoutOptions) -> tuple[set[str], str]:
    """(names held out, how the split is called in tables)."""
    stated = {photograph.name for photograph in photographs if photograph.test}
    if stated and len(stated) < len(photographs):
        return stated, "the layout's test frames"
    # Camera number -> how messages call it.
    cameras = {p.group: f"{p.group} ({p.folder})" if p.folder else f"{p.group}" for p in photographs}
    times = len({photograph.time for photograph in photographs})
    rig = times < len(photographs) or _stand_still(photographs)
    if (len(cameras) > 2 and rig) or (len(cameras) > 1 and list(options.test_cameras) != [0]):
        # 0, the default, is the first camera also where a folder counts from 1.
        chosen = sorted({min(cameras) if number == 0 else number for number in options.test_cameras})
        if not set(chosen) < set(cameras):
            known = ", ".join(cameras[number] for number in sorted(cameras))
            raise SceneError(f"{root}: scene.test_cameras", f"some of the cameras {known}", f"{chosen}")
        names = {photograph.name for photograph in photographs if photograph.group in chosen}
        return names, "camera " + ", ".join(cameras[number] for number in chosen)
    every = options.test_every
    groups = sorted(cameras)
    held_out = {
        photograph.name
        for number, group in enumerate(groups)  # of two cameras at one time not both
        for photograph in [p for p in photographs if p.group == group][
            (every // 2 + number * every // len(groups)) % every :: every
        ]
    }
    if not held_out:
        held_out = {photographs[len(photographs) // 2].name}
    return held_out, f"every {ordinal(every)} frame"


def ordinal(number: int) -> str:
    """ "2nd", "3rd", "8th"."""
    ending = {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th") if number % 100 not in (11, 12, 13) else "th"
    return f"{number}{ending}"


def _mask(photograph: Photograph, downscale: int) -> np.ndarray | None:
    """(H, W) bool of the reduced image: pixels all of whose parts count."""
    if photograph.mask is None:
        return None
    if not is_file(photograph.mask):
        raise SceneError(photograph.mask, f"the mask of {photograph.name}", "no such file")
    rgba = read_rgba(photograph.mask)
    width, height = photograph.camera.width, photograph.camera.height
    if rgba.shape[:2] != (height, width):
        raise SceneError(photograph.mask, f"{width} x {height} pixels, as its image", "{1} x {0}".format(*rgba.shape))
    counts = np.where(rgba[..., :3].any(axis=2), 255, 0).astype(np.uint8)  # tools write 0 and 1, or 0 and 255
    if photograph.lens:
        counts = undistort(counts, photograph.lens.maps((width, height)))
    small = compose(np.dstack([counts] * 3 + [np.full_like(counts, 255)]), BLACK, downscale)[..., 0]
    return small == 255


def _last_number(stem: str) -> float | None:
    """12 of "frame_012"; the whole of a name that is seconds, as 1305031102.175304."""
    if re.fullmatch(r"\d+\.\d+", stem):
        return float(stem)
    found = re.findall(r"\d+", stem)
    return float(found[-1]) if found else None
