"""A clip opened: its header checked, its frames chosen and read. Cameras come later, from structure from motion."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from datasets.cameras.lens import Undistortion, imaged, undistort
from datasets.canonical import canonical_space
from datasets.clip.choose import Choice, choose
from datasets.clip.survey import MOST_SURVEYED, survey
from datasets.composition import BLACK, Color, background_color, chosen_downscale, reduced_camera
from datasets.files.errors import SceneError
from datasets.files.image_files import read_rgba
from datasets.plenoptic.decode import reduce_image
from datasets.plenoptic.unsynchronised import covering
from datasets.plenoptic.videos import video_paths
from datasets.scene import Scene, View, camera_extent, capture_of, make_camera, validate_scene
from datasets.settings import SceneConfig
from datasets.source import Log
from datasets.validation import ordinal
from datasets.video_files.decode import IMAGE_RATE, Frame, image_frames, image_paths, video_frames
from datasets.video_files.probe import Header, probe
from rasterizer.camera import Camera

FEWEST_FRAMES = 12  # with fewer neither motion nor a held-out frame can be told
SFM_SIDE = 1024  # pixels: the longer side of the images that structure from motion gets is not longer
PLAYBACK_RATES = (5.0, 60.0)  # frames a second of rendered videos


@dataclass(frozen=True)
class ClipFrame:
    """A frame in use."""

    name: str  # "frame_00012", by its number in the clip
    time: float  # seconds since the clip's start
    image: np.ndarray  # (H, W, 3) uint8 RGB, without bars, reduced by Clip.reduced


@dataclass(frozen=True)
class Clip:
    """The frames in use, in order; their cameras are not known yet."""

    source: Path
    header: Header | None  # None: a folder of images
    frames: tuple[ClipFrame, ...]
    size: tuple[int, int]  # (width, height) of the file's frames without bars
    reduced: int  # the frames' images are at 1/reduced of that
    downscale: int  # of the training images
    choice: Choice
    cfg: SceneConfig

    def to_scene(self, cameras: Mapping[str, Camera], radial: float = 0.0, unit: float | None = None) -> Scene:
        """The scene of the frames that have a camera (name -> camera of its photograph). Other frames are left out.

        radial: the lens's distortion (OpenCV's k1). unit: world units per normalised unit; None: the canonical unit.
        """
        kept = [frame for frame in self.frames if frame.name in cameras]
        cameras = {frame.name: self.frame_camera(cameras[frame.name]) for frame in kept}
        held_out = _held_out(self.source, len(kept), self.cfg.test_every)
        views: dict[str, list[View]] = {"train": [], "test": []}
        lens, size = Undistortion.of(cameras[kept[0].name], radial) if radial else None, _size(kept[0].image)
        maps = lens.maps(size) if lens else None
        for index, frame in enumerate(kept):
            split = "test" if index in held_out else "train"
            image = undistort(frame.image, maps) if maps else frame.image
            camera, image = self.training_view(cameras[frame.name], image)
            mask = imaged(lens, size, (camera.width, camera.height))
            views[split].append(View(camera, frame.time - kept[0].time, image, f"{split}/{frame.name}", mask=mask))
        return scene_of_views(
            views,
            name=self.cfg.name,
            source=self.source,
            duration=kept[-1].time - kept[0].time,
            unit=unit,
            rate=playback_rate([frame.time for frame in kept]),
            test_split=f"every {ordinal(self.cfg.test_every)} frame",
            background=background_color(self.cfg.background) or BLACK,
        )

    @property
    def further(self) -> int:
        """Photographs for structure from motion are at 1/further of ClipFrame.image."""
        return _sfm_reduction((self.size[0] // self.reduced, self.size[1] // self.reduced))

    def photograph(self, frame: ClipFrame) -> np.ndarray:
        """(H, W, 3) uint8: the frame for structure from motion, SFM_SIDE pixels at most on the longer side."""
        return reduce_image(frame.image, self.further)

    def frame_camera(self, camera: Camera) -> Camera:
        """The camera of ClipFrame.image, of that of the frame's photograph."""
        if self.further == 1:
            return camera
        whole = camera.resized(camera.width * self.further, camera.height * self.further)
        return replace(whole, width=self.size[0] // self.reduced, height=self.size[1] // self.reduced)

    def training_view(self, camera: Camera, image: np.ndarray) -> tuple[Camera, np.ndarray]:
        """Camera and image of a frame (undistorted) at the size of training."""
        if self.downscale % self.reduced == 0:
            further = self.downscale // self.reduced
            small = make_camera(self.source, partial(reduced_camera, camera, further))
            return small, reduce_image(image, further)
        width, height = (max(1, side // self.downscale) for side in self.size)
        return camera.resized(width, height), cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)


def is_clip(path: Path) -> bool:
    """Whether `path` is a video file, or a folder with a single video, or with images and no video."""
    if not path.is_dir():
        return path.is_file()
    videos = video_paths(path)
    return len(videos) == 1 or (not videos and bool(image_paths(path)))


def open_clip(path: Path, cfg: SceneConfig, log: Log) -> Clip:
    """Reads the frames in use of a clip. SceneError for what cannot be used, with what to do instead."""
    if not path.exists():
        raise SceneError(path, "a video, or a folder of videos or of images in order", "nothing there")
    if path.is_dir() and (videos := video_paths(path)):
        path = videos[0]
    if cfg.test_every == 0:
        raise SceneError("scene.test_every", "at least 2 for one camera that moves", "0")
    clip = survey_clip(path, cfg, cfg.frames, log).read()
    _held_out(path, len(clip.frames), cfg.test_every)  # before structure from motion
    return clip


def survey_clip(path: Path, cfg: SceneConfig, most: int, log: Log, still: bool = False) -> SurveyedClip:
    """Chooses the frames in use, `most` at most. still: the camera stands still, so that frames may be alike."""
    header = None if path.is_dir() else probe(path)
    source = _Source(path, header, background_color(cfg.background) or BLACK)
    if header:
        for note in header.notes():
            log(f"{path.name}: {note}")
    total = source.count()
    every = max(1, -(-total // MOST_SURVEYED))
    found = survey((f for f in source.frames(every=every) if f.index >= cfg.first_frame), total)
    if found is None:
        _refuse_late_first_frame(source, cfg.first_frame, every, total)
        if header is None and (images := image_paths(path)):
            read_rgba(images[0])  # says what it is instead
        raise SceneError(path, "frames that can be decoded", "none")
    choice = choose(found, most, still)
    for note in choice.notes:
        log(f"{path.name}: {note}")
    if len(choice.indices) < FEWEST_FRAMES:
        sharp = len(choose(found, found.total, still).indices)
        if sharp >= FEWEST_FRAMES:
            raise SceneError(
                f"{path}: scene.frames",
                f"more, to use {FEWEST_FRAMES} of the clip's {sharp} sharp frames at least",
                f"{most}, which uses {len(choice.indices)}",
            )
        start = f" from scene.first_frame={cfg.first_frame} on" if cfg.first_frame else ""
        raise SceneError(
            path,
            f"at least {FEWEST_FRAMES} sharp frames of one take",
            f"{sharp} of {found.total}{start}; film 5 to 20 seconds while walking around what you film",
        )
    left, top, right, bottom = found.content
    size = (right - left, bottom - top)
    if header is not None and size != header.size:
        log(f"{path.name}: black bars are cut off, {size[0]} x {size[1]} pixels are left")
    return SurveyedClip(source, choice, found.content, cfg)


@dataclass(frozen=True)
class SurveyedClip:
    """A clip whose frames in use are chosen, and not read yet."""

    source: _Source
    choice: Choice
    content: tuple[int, int, int, int]  # left, top, right, bottom of the image without bars, pixels
    cfg: SceneConfig

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels, without bars."""
        left, top, right, bottom = self.content
        return right - left, bottom - top

    def read(self, size: tuple[int, int] | None = None) -> Clip:
        """The clip with its frames. size: (width, height) that they are scaled to cover; None: their own."""
        source = self.source
        left, top, right, bottom = self.content
        size = size or self.size
        downscale = self.cfg.downscale or chosen_downscale(size)
        reduced = min(_sfm_reduction(size), downscale)  # training images are never enlarged
        times = dict(zip(self.choice.indices, self.choice.times))
        frames = []
        for frame in source.frames(keep=set(self.choice.indices)):
            if frame.image is not None:
                image = covering(np.ascontiguousarray(frame.image[top:bottom, left:right]), size)
                frames.append(ClipFrame(f"frame_{frame.index:05d}", times[frame.index], reduce_image(image, reduced)))
        _refuse_other_sizes(source.path, frames)
        return Clip(source.path, source.header, tuple(frames), size, reduced, downscale, self.choice, self.cfg)


@dataclass(frozen=True)
class _Source:
    """A video file or a folder of images."""

    path: Path
    header: Header | None
    background: Color  # under transparent pixels of images

    def count(self) -> int:
        """Frames, an estimate where the header does not say."""
        if self.header is None:
            return len(image_paths(self.path))
        return self.header.count or round((self.header.seconds or 0.0) * (self.header.rate or IMAGE_RATE))

    def frames(self, keep: set[int] | None = None, every: int = 1) -> Iterator[Frame]:
        if self.header is None:
            return image_frames(image_paths(self.path), keep, every, self.background)
        return video_frames(self.path, self.header, keep, every)


def _held_out(path: Path, count: int, every: int) -> set[int]:
    """Places of the held-out ones of `count` frames; SceneError if there is none."""
    held_out = set(range(every // 2, count, every))
    if not held_out:
        raise SceneError(f"{path}: scene.test_every", f"below {2 * count}, twice the frames in use", f"{every}")
    return held_out


def _refuse_late_first_frame(source: _Source, first_frame: int, every: int, total: int) -> None:
    """SceneError if the clip has ended before `first_frame`."""
    whole = survey(source.frames(every=every), total) if first_frame else None
    if whole is not None and (last := int(whole.index[-1])) < first_frame:
        raise SceneError(
            f"{source.path}: scene.first_frame", f"below the {last + 1} frames of the clip", f"{first_frame}"
        )


def _sfm_reduction(size: tuple[int, int]) -> int:
    """By which images of `size` are reduced for structure from motion."""
    return max(1, -(-max(size) // SFM_SIDE))


def _size(image: np.ndarray) -> tuple[int, int]:
    return image.shape[1], image.shape[0]


def _refuse_other_sizes(path: Path, frames: list[ClipFrame]) -> None:
    for frame in frames:
        if frame.image.shape != frames[0].image.shape:
            raise SceneError(
                path / frame.name,
                "{} x {} pixels as {}".format(*_size(frames[0].image), frames[0].name),
                "{} x {}".format(*_size(frame.image)),
            )


def scene_of_views(
    views: Mapping[str, Sequence[View]],
    *,
    name: str,
    source: Path,
    duration: float,
    unit: float | None,
    rate: float,
    test_split: str,
    background: Color,
) -> Scene:
    """The scene of the views of both splits, "train" and "test", whose first time is 0; duration in seconds.

    unit: world units per normalised unit; None: the canonical unit of the training cameras. rate: frames a second of
    rendered videos.
    """
    train = [view.camera for view in views["train"]]
    space = canonical_space(train, unit)
    return validate_scene(
        Scene(
            name=name,
            train=tuple(views["train"]),
            test=tuple(views["test"]),
            duration=duration,
            time_start=0.0,
            background=background,
            extent=camera_extent(train),
            init_box=space.inverse.box((-1.2, 1.2)),
            source=source,
            capture=capture_of(views["train"], views["test"], filmed=True),
            unit=unit or space.unit,
            playback_rate=rate,
            test_split=test_split,
        )
    )


def playback_rate(times: Sequence[float]) -> float:
    """Frames a second at which frames of these times (seconds, ascending) last as long as they did."""
    return float(np.clip((len(times) - 1) / max(times[-1] - times[0], 1e-3), *PLAYBACK_RATES))
