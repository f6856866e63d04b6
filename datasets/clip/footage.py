"""The clip of one camera: its header checked, its frames chosen and read."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from datasets.clip.choose import Choice, choose
from datasets.clip.progress import counted
from datasets.clip.survey import FEWEST_SURVEYED, MOST_SURVEYED, SURVEYED_PER_FRAME, survey
from datasets.composition import BLACK, background_color, chosen_downscale, reduced_camera
from datasets.files.errors import SceneError
from datasets.files.image_files import read_rgba
from datasets.files.unused_masks import unused_masks
from datasets.plenoptic.align import covering
from datasets.plenoptic.decode import reduce_image
from datasets.scene import make_camera
from datasets.settings import SceneConfig
from datasets.source import Log
from datasets.video_files.film import open_film
from datasets.video_files.frame import Frame
from datasets.video_files.image_folder import image_frames, image_paths
from rasterizer.camera import Camera

FEWEST_FRAMES = 12  # with fewer neither motion nor a held-out frame can be told
# Pixels of the images for structure from motion: of the longer side, of wide ones of the area. What tells the motion of
# a car is a band of small details.
SFM_SIDE, SFM_AREA = 1024, 1024 * 576

Frames = Callable[..., Iterator[Frame]]  # Film.frames or image_frames, but for `keep` and `every`


@dataclass(frozen=True)
class ClipFrame:
    """A frame in use."""

    name: str  # "frame_00012", by its number in the clip
    time: float  # seconds since the clip's start
    image: np.ndarray  # (H, W, 3) uint8 RGB, without bars, reduced by Clip.reduced


@dataclass(frozen=True)
class Clip:
    """The frames in use of one camera, in order; its poses are not known yet."""

    source: Path
    frames: tuple[ClipFrame, ...]
    size: tuple[int, int]  # (width, height) of the file's frames without bars
    reduced: int  # the frames' images are at 1/reduced of that
    downscale: int  # of the training images
    name: str = ""  # of several cameras: that of its file, without the suffix
    number: int = 0  # as in scene.test_cameras and scene.drop_cameras
    start: float = 0.0  # seconds of the common clock
    drift: float = 0.0  # seconds of the common clock per second of its own, less 1
    still: bool = False

    def time(self, frame: ClipFrame) -> float:
        """On the common clock, seconds."""
        return self.start + frame.time * (1 + self.drift)

    def photograph_name(self, frame: ClipFrame) -> str:
        """Name of the photograph that has the frame's pose: of a camera that stands still one for all frames."""
        name = (self.frames[0] if self.still else frame).name
        return f"{self.number:02d}_{name}" if self.name else name

    @property
    def further(self) -> int:
        """Photographs for structure from motion are at 1/further of ClipFrame.image."""
        return _sfm_reduction((self.size[0] // self.reduced, self.size[1] // self.reduced))

    def photograph(self, frame: ClipFrame) -> np.ndarray:
        """(H, W, 3) uint8: the frame for structure from motion, reduced to SFM_SIDE or SFM_AREA."""
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


def survey_clip(path: Path, cfg: SceneConfig, most: int, log: Log, still: bool = False) -> SurveyedClip:
    """Chooses the frames in use, `most` at most. still: the camera stands still, so that frames may be alike."""
    film = None if path.is_dir() else open_film(path, Path(cfg.cache))
    frames: Frames
    if film:
        frames, total = film.frames, film.count
    else:
        images, background = image_paths(path), background_color(cfg.background) or BLACK
        if masks := unused_masks(images):
            log(f"{masks}: not used; the region that moves is found and left out of structure from motion")
        frames, total = partial(image_frames, images, background=background), len(images)
    every = max(1, -(-total // min(MOST_SURVEYED, max(FEWEST_SURVEYED, SURVEYED_PER_FRAME * most))))
    looked_at = counted(frames(every=every), -(-total // every), path.name, log)
    found = survey((f for f in looked_at if f.index >= cfg.first_frame), total)
    if found is None:
        last = max((f.index for f in frames(every=every) if f.image is not None), default=cfg.first_frame)
        if last < cfg.first_frame:
            raise SceneError(
                f"{path}: scene.first_frame", f"below the {last + 1} frames of the clip", f"{cfg.first_frame}"
            )
        if film is None and total:
            read_rgba(image_paths(path)[0])  # says what it is instead
        raise SceneError(path, "frames that can be decoded", "none")
    choice = choose(found, most, still)
    notes = [*(film.notes() if film else ()), *choice.notes]
    if notes:
        log(f"{path.name}: {'; '.join(notes)}")
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
    surveyed = SurveyedClip(path, frames, choice, found.content, cfg)
    if film is not None and surveyed.size != film.size:
        log(f"{path.name}: black bars are cut off, {{}} x {{}} pixels are left".format(*surveyed.size))
    return surveyed


@dataclass(frozen=True)
class SurveyedClip:
    """A clip whose frames in use are chosen, and not read yet."""

    path: Path
    all_frames: Frames
    choice: Choice
    content: tuple[int, int, int, int]  # left, top, right, bottom of the image without bars, pixels
    cfg: SceneConfig

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels, without bars."""
        left, top, right, bottom = self.content
        return right - left, bottom - top

    def read(self, size: tuple[int, int]) -> Clip:
        """The clip with its frames. size: (width, height) that they are scaled to cover."""
        left, top, right, bottom = self.content
        downscale = self.cfg.downscale or chosen_downscale(size)
        reduced = min(_sfm_reduction(size), downscale)  # training images are never enlarged
        times = dict(zip(self.choice.indices, self.choice.times))
        frames = []
        for frame in self.all_frames(keep=set(self.choice.indices)):
            if frame.image is not None:
                image = covering(np.ascontiguousarray(frame.image[top:bottom, left:right]), size)
                frames.append(ClipFrame(f"frame_{frame.index:05d}", times[frame.index], reduce_image(image, reduced)))
        return Clip(self.path, tuple(frames), size, reduced, downscale)


def _sfm_reduction(size: tuple[int, int]) -> int:
    """By which images of `size` are reduced for structure from motion."""
    by_area = math.ceil(math.sqrt(size[0] * size[1] / SFM_AREA))
    return max(1, min(-(-max(size) // SFM_SIDE), by_area))
