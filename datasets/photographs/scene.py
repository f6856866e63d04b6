"""The `Scene` that photographs with cameras and times make.

Images are read when they are first used, so that memory does not grow with a folder of thousands: only their headers
are read here, those with alpha, and a few for the background.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from datasets.cameras.lens import both
from datasets.canonical import canonical_space
from datasets.composition import (
    BLACK,
    Color,
    background_color,
    chosen_background,
    chosen_downscale,
    compose,
    coverage,
    reduced_camera,
)
from datasets.files.errors import SceneError
from datasets.files.image_files import has_alpha
from datasets.files.natural_order import natural_order
from datasets.files.unused_masks import unused_masks
from datasets.photographs.file_names import stand_still, with_times
from datasets.photographs.masks import read_mask, say_masks
from datasets.photographs.photograph import PosedFile, of_one_size, say_folds, say_turns
from datasets.photographs.selection import FEWEST, held_out_names, within_limits, without_cameras
from datasets.scene import (
    PLAYBACK_RATE,
    USUAL_BOX,
    Scene,
    ScenePoints,
    View,
    camera_extent,
    capture_of,
    make_camera,
    validate_scene,
)
from datasets.settings import SceneConfig
from datasets.source import Log
from rasterizer.camera import Camera

KEPT_BYTES = 1 << 30  # of decoded images, which are then kept; more are read again at each use
BORDER_IMAGES = 12  # evenly spread training images whose borders are looked at


class FileImage:
    """Pixels (H, W, 3) uint8 of a photograph, read when needed; `np.asarray` reads them."""

    dtype = np.dtype(np.uint8)

    def __init__(self, photograph: PosedFile, shape: tuple[int, int, int], downscale: int, background: Color) -> None:
        self.shape: tuple[int, ...] = shape
        self._photograph, self._downscale, self._background = photograph, downscale, background
        self.keep = False
        self._pixels: np.ndarray | None = None

    def __array__(self, dtype: np.dtype | None = None, copy: bool | None = None) -> np.ndarray:
        image = self._pixels
        if image is None:
            image = compose(self._photograph.read(), self._background, self._downscale)
        if self.keep:
            self._pixels = image
        return image if dtype is None else image.astype(dtype, copy=False)

    def larger(self, longest: int) -> tuple[np.ndarray, Camera, np.ndarray | None]:
        """(pixels, camera, (h, w) bool of the pixels that count or None) of the file, reduced by a whole number.

        The longer side is `longest` pixels at most.
        """
        photograph = self._photograph
        downscale = -(-max(photograph.camera.width, photograph.camera.height) // longest)
        camera = reduced_camera(photograph.camera, downscale)
        mask = both(read_mask(photograph, downscale), photograph.imaged(camera))
        return compose(photograph.read(), self._background, downscale), camera, mask


def to_scene(
    root: Path, photographs: Sequence[PosedFile], cfg: SceneConfig, log: Log, points: ScenePoints | None = None
) -> Scene:
    """The scene of photographs in any order. SceneError where they do not make one."""
    photographs = without_cameras(root, photographs, cfg)
    photographs = with_times(sorted(photographs, key=lambda photograph: natural_order(photograph.name)), log)
    if len(photographs) < FEWEST:
        raise SceneError(root, f"at least {FEWEST} photographs with a camera", f"{len(photographs)}")
    photographs = within_limits(root, photographs, cfg, log)
    (same, count), *_ = Counter((photograph.name, photograph.path) for photograph in photographs).most_common(1)
    if count > 1:
        raise SceneError(root, "each photograph once", f"{same[1]} {count} times")
    if len({photograph.name for photograph in photographs}) < len(photographs):  # left/1.png and right/1.png
        photographs = [
            replace(photograph, name=f"{i:05d}_{photograph.name}") for i, photograph in enumerate(photographs)
        ]
    photographs, size = of_one_size(photographs)
    if any(photograph.size for photograph in photographs):
        log("images of different sizes are cut at the right and below, to {} x {}".format(*size))
    say_folds(photographs, log)
    say_turns(photographs, log)
    downscale = cfg.downscale or chosen_downscale(size)
    if min(size) < downscale:
        raise SceneError(root, f"at least {downscale} pixels a side (scene.downscale)", "{} x {}".format(*size))
    held_out, how = held_out_names(root, photographs, cfg)
    log(f"held out: {how}")
    trained = [photograph for photograph in photographs if photograph.name not in held_out]
    requested = background_color(cfg.background)
    composed_over = requested or BLACK
    views: dict[str, list[View]] = {"train": [], "test": []}
    cameras_film = stand_still(trained)
    one_camera = len({photograph.group for photograph in trained}) == 1
    cameras: dict[int, Camera] = {}
    for photograph in photographs:
        split = "test" if photograph.name in held_out else "train"
        small = cameras.setdefault(
            id(photograph.camera), make_camera(photograph.path, partial(reduced_camera, photograph.camera, downscale))
        )
        image = FileImage(photograph, (small.height, small.width, 3), downscale, composed_over)
        image.keep = len(photographs) * 3 * small.width * small.height <= KEPT_BYTES
        assert photograph.time is not None
        alpha = coverage(photograph.read(), downscale) if has_alpha(photograph.path) else None
        name, mask = f"{split}/{photograph.name}", both(read_mask(photograph, downscale), photograph.imaged(small))
        camera_name = f"{photograph.group}" if cameras_film else ""
        views[split].append(View(small, photograph.time, image, name, alpha, mask=mask, filmed_by=camera_name))
    train_cameras = [view.camera for view in views["train"]]
    background = _background(views["train"], requested, log)
    if any(photograph.mask for photograph in photographs):
        say_masks(root, [*views["train"], *views["test"]], points, log)
    elif found := unused_masks([photograph.path for photograph in photographs]):
        log(f"{found}: not used, as it may show what counts or what does not; mask_path in transforms.json names masks")
    space = canonical_space(train_cameras)
    times = [photograph.time for photograph in photographs if photograph.time is not None]
    low, high = min(times), max(times)
    duration = high - low or 1.0
    while low + duration < high:  # rounding
        duration = float(np.nextafter(duration, np.inf))
    return validate_scene(
        Scene(
            name=cfg.name,
            train=tuple(views["train"]),
            test=tuple(views["test"]),
            duration=duration,
            time_start=low,
            background=background,
            extent=camera_extent(train_cameras),
            init_box=space.inverse.box(USUAL_BOX),
            source=root,
            capture=capture_of(views["train"], views["test"], filmed=one_camera),
            unit=space.unit,
            playback_rate=PLAYBACK_RATE if one_camera and high > low else None,
            points=points,
            test_split=how,
        )
    )


def _background(views: Sequence[View], requested: Color | None, log: Log) -> Color:
    """By scene.background; auto: of opaque images, the border colour of BORDER_IMAGES of them."""
    if any(view.coverage is not None for view in views):
        return chosen_background([], False, requested, log)
    chosen = np.unique(np.linspace(0, len(views) - 1, BORDER_IMAGES).round().astype(int))
    images = [np.asarray(views[index].image) for index in chosen]
    return chosen_background(images, True, requested, log)
