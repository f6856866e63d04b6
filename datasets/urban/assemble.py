"""Makes the Scene of a driving log: selects frames and cameras, holds frames out, reads images, masks and sweeps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from PIL import Image

from datasets.cameras.lens import Undistortion
from datasets.composition import BLACK, background_color, compose, reduced_camera
from datasets.files.errors import SceneError
from datasets.ground_truth import StoredTruth, any_moving
from datasets.photographs.photograph import PosedFile
from datasets.scene import Scene, Sweep, View, bounding_cube, camera_extent, make_camera, validate_scene
from datasets.settings import SceneConfig
from datasets.source import Calibration, Log, Photograph, Source
from datasets.urban.log import DrivingLog, LogImage, LogSweep, SweepPoints
from datasets.urban.moving import with_moving_masks
from datasets.urban.projection import depth_image, in_image, project
from datasets.urban.sky import estimate_sky
from datasets.validation import ordinal
from rasterizer.camera import Camera

UNIT = 5.0  # metres per normalised unit: the near plane is at 1 m
BY_MASKS = "masks of the data"
SURROUNDINGS = 30.0  # metres on every side of the way, in which random points are drawn
SFM_IMAGES = 60  # evenly spaced, that structure from motion takes


@dataclass(frozen=True)
class DriveSource(Source):
    """A driving log: cameras on a car, with LiDAR or without. Its times are of one clock, its poses known."""

    cfg: SceneConfig
    log: DrivingLog
    say: Log
    unit: float = UNIT

    @property
    def path(self) -> Path:
        return self.log.source

    @cached_property
    def _scene(self) -> Scene:
        return scene_of_log(self.log, self.cfg, self.say)

    @property
    def points(self) -> Literal["sfm", "lidar"]:
        return "lidar" if self._scene.sweeps else "sfm"

    def photographs(self) -> list[Photograph]:
        views = self._scene.train
        chosen = np.unique(np.linspace(0, len(views) - 1, SFM_IMAGES).round().astype(int))
        return [
            Photograph(view.name.replace("/", "_"), np.asarray(view.image), view.camera)
            for view in (views[index] for index in chosen)
        ]

    def scene(self, found: Calibration | None = None) -> Scene:
        return self._scene


def scene_of_log(log: DrivingLog, cfg: SceneConfig, say: Log = lambda line: None) -> Scene:
    """The scene of a log under the settings of `scene`, in metres and seconds. Raises SceneError for invalid data.

    Every `test_every`-th frame is held out with all its cameras and its sweep; with `validation_every` every so many
    of the other frames instead.
    """
    if background_color(cfg.background) not in (None, BLACK):
        raise SceneError("scene.background", "auto or black for a driving log", f"{cfg.background}")
    if cfg.validation_outermost:
        raise SceneError("scene.validation_outermost", "false for a driving log, held out by frames", "true")
    images = _selected(log, cfg)
    if cfg.sky_masks == "files" and not any(image.sky for image in images):
        raise SceneError(f"{log.source}: scene.sky_masks", "auto, estimated or none for a log without masks", "files")
    frames = sorted({image.frame for image in images})
    train_frames, test_frames, rule = split_frames(frames, cfg.test_every, cfg.validation_every, log)
    used = set(train_frames) | set(test_frames)
    images = [image for image in images if image.frame in used]
    sweeps = [sweep for sweep in log.sweeps if sweep.frame in used]
    cameras = sorted({image.number for image in images})
    say(
        f"{log.layout}: {len(frames)} frames, cameras {', '.join(map(str, cameras))}, {len(sweeps)} LiDAR sweeps; "
        f"held out: {rule}"
    )

    views: dict[int, list[View]] = {frame: [] for frame in used}
    for image in images:
        split = "test" if image.frame in test_frames else "train"
        views[image.frame].append(_view(image, split, cfg))
    points = {sweep.frame: sweep.read() for sweep in sweeps}
    for note, count in Counter(found.note for found in points.values() if found.note).items():
        say(f"{count} of {len(points)} LiDAR sweeps: {note}")
    if cfg.sky_masks == "estimated" or (cfg.sky_masks == "auto" and not any(image.sky for image in images)):
        say("sky masks: estimated from colour, edges and LiDAR (scene.sky_masks)")
        views = {frame: [_with_sky(view, points.get(frame)) for view in listed] for frame, listed in views.items()}
    times = [image.time for image in images] + [sweep.time for sweep in sweeps]
    start = min(times)

    def views_of(chosen: Iterable[int]) -> tuple[View, ...]:
        return tuple(replace(view, time=view.time - start) for frame in chosen for view in views[frame])

    def sweeps_of(chosen: Iterable[int]) -> tuple[Sweep, ...]:
        found = [sweep for sweep in sweeps if sweep.frame in set(chosen)]
        return tuple(_sweep(sweep, points[sweep.frame], views[sweep.frame], start) for sweep in found)

    has_masks = any(image.moving is not None for image in images)
    train = views_of(train_frames)
    train_cameras = [view.camera for view in train]
    positions = np.stack([camera.position for camera in train_cameras])
    return validate_scene(
        with_moving_masks(
            Scene(
                name=cfg.name,
                train=train,
                test=views_of(test_frames),
                duration=float(max(times) - start) or 1.0,
                time_start=0.0,
                background=BLACK,
                extent=camera_extent(train_cameras),
                init_box=bounding_cube(positions, SURROUNDINGS),
                source=log.source,
                capture="drive",
                unit=UNIT,
                sweeps=sweeps_of(train_frames),
                test_sweeps=sweeps_of(test_frames),
                metre=1.0,
                moving_by=BY_MASKS if has_masks else None,
                test_split=rule,
            )
        )
    )


def split_frames(
    frames: list[int], test_every: int, validation_every: int, log: DrivingLog
) -> tuple[list[int], list[int], str]:
    """(training frames, held-out frames, the rule in words). A frame is held out if its place, counted from 1, is a
    multiple of `test_every`, as in the authors' code."""
    test = frames[test_every - 1 :: test_every]
    train = [frame for frame in frames if frame not in set(test)]
    rule = f"every {ordinal(test_every)} frame"
    if validation_every:
        test = train[validation_every // 2 :: validation_every]
        train = [frame for frame in train if frame not in set(test)]
        rule = f"every {ordinal(validation_every)} of the training frames (validation)"
        if not test or not train:
            raise SceneError(
                f"{log.source}: scene.validation_every",
                f"a number that leaves both training and held-out ones of {len(train) + len(test)} frames",
                f"{validation_every}",
            )
    if not test or not train:
        raise SceneError(f"{log.source}: scene.test_every", f"at most the {len(frames)} frames in use", str(test_every))
    return train, test, rule


def _selected(log: DrivingLog, cfg: SceneConfig) -> list[LogImage]:
    """The images of the cameras and frames in use."""
    there = sorted({image.number for image in log.images})
    wanted = list(cfg.log_cameras) if cfg.log_cameras is not None else [n for n in log.usual_cameras if n in there]
    wanted = [number for number in wanted or there if number not in cfg.drop_cameras]
    missing = [number for number in wanted if number not in there]
    if missing or not wanted:
        raise SceneError(
            f"{log.source}: scene.log_cameras", f"some of cameras {', '.join(map(str, there))}", str(missing or wanted)
        )
    last = cfg.first_frame + cfg.frames
    found = [i for i in log.images if i.number in wanted and cfg.first_frame <= i.frame < last]
    if not found:
        raise SceneError(f"{log.source}: scene.first_frame", f"below the {log.frames} frames", str(cfg.first_frame))
    # Frame by frame, cameras in the order asked for.
    return sorted(found, key=lambda image: (image.frame, wanted.index(image.number)))


def _view(image: LogImage, split: str, cfg: SceneConfig) -> View:
    """The image at 1/downscale of its size, undistorted, with its masks."""
    full = image.camera
    lens = Undistortion.of(full, *image.distortion) if any(image.distortion) else None
    file = PosedFile(image.name, image.path, full, lens)
    rgba = file.read()
    if min(full.width, full.height) < cfg.downscale:
        raise SceneError(image.path, f"at least {cfg.downscale} pixels a side (downscale)", f"{full.width}")
    camera = make_camera(image.path, lambda: reduced_camera(full, cfg.downscale))
    shape = camera.height, camera.width
    maps = lens.maps((full.width, full.height)) if lens else None
    sky = moving = None
    if image.sky is not None and cfg.sky_masks in ("auto", "files"):
        sky = majority(_mask(image.sky, full, maps), *shape, cfg.downscale)
    if image.moving is not None:
        covered = _mask(image.moving, full, maps)[: shape[0] * cfg.downscale, : shape[1] * cfg.downscale]
        moving = any_moving(covered, shape[1], shape[0])
    # That of a distorted image is distorted as well.
    truth = None if image.truth is None or maps is not None else StoredTruth(image.truth, downscale=cfg.downscale)
    return View(
        camera,
        image.time,
        compose(rgba, BLACK, cfg.downscale),
        f"{split}/{image.name}",
        truth=truth,
        frame=image.frame,
        sky=sky,
        moving=moving,
        mask=file.imaged(camera),
        filmed_by=f"{image.number}",
    )


def majority(mask: np.ndarray, height: int, width: int, side: int) -> np.ndarray:
    """(height, width) bool: whether most of each block of side × side pixels of `mask` is True."""
    blocks = mask[: height * side, : width * side].reshape(height, side, width, side)
    return blocks.mean(axis=(1, 3)) > 0.5


def _mask(path: object, camera: Camera, maps: tuple[np.ndarray, np.ndarray] | None) -> np.ndarray:
    """(H, W) bool: where a mask of the data is above 0; undistorted like its image, without interpolation."""
    try:
        with Image.open(str(path)) as file:
            mask = np.asarray(file.convert("L")) > 0
    except Exception as error:  # PIL raises many types for broken files
        raise SceneError(str(path), "a readable mask", str(error)) from None
    if mask.shape != (camera.height, camera.width):
        raise SceneError(
            str(path), f"{camera.width} x {camera.height} pixels as its image", "{1} x {0}".format(*mask.shape)
        )
    if maps is None:
        return mask
    return cv2.remap(mask.astype(np.uint8), *maps, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE) > 0


def _with_sky(view: View, sweep: SweepPoints | None) -> View:
    depth = None if sweep is None else depth_image(sweep.points, view.camera)
    return replace(view, sky=estimate_sky(np.asarray(view.image), depth))


def _sweep(sweep: LogSweep, read: SweepPoints, views: list[View], start: float) -> Sweep:
    """The sweep's points that a camera of its frame sees; others neither supervise nor get a colour."""
    seen = np.zeros(len(read.points), dtype=bool)
    for view in views:
        seen |= in_image(*project(read.points, view.camera), view.camera)
    return Sweep(sweep.frame, sweep.time - start, read.origin, read.points[seen])
