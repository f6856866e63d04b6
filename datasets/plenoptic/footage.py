"""Footage: synchronised videos or image sequences of several cameras, which camera poses turn into a `Scene`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from datasets.cameras.color import ColorCorrection
from datasets.cameras.lens import Lens, imaged, undistort
from datasets.canonical import FRAMES_PER_UNIT
from datasets.composition import BLACK, background_color, reduced_camera
from datasets.files.errors import SceneError
from datasets.ground_truth import StoredTruth
from datasets.plenoptic.align import FilmStream, padded
from datasets.plenoptic.decode import Decoding, Stream, decode
from datasets.plenoptic.sync import drop_advice
from datasets.scene import (
    Box,
    Image,
    Scene,
    View,
    bounding_cube,
    camera_extent,
    capture_of,
    make_camera,
    validate_scene,
)
from datasets.settings import SceneConfig
from datasets.source import Log
from datasets.video_files.film import keep_film
from rasterizer.camera import Camera
from rasterizer.cores import thread_count

# Rates outside this range are taken to be per millisecond, per frame or the like, not per second.
PLAYBACK_RATES = (5.0, 1000.0)


@dataclass(frozen=True)
class Footage:
    """Synchronised cameras in use; nothing is decoded yet, and poses may be unknown."""

    source: Path  # the folder
    streams: tuple[Stream, ...]  # the cameras in use
    count: int  # ticks in use; a camera may lack frames
    content: str  # hash of all files of the data set
    cfg: SceneConfig
    threads: int  # for decoding; 0: all cores
    log: Log

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(stream.name for stream in self.streams)

    @property
    def held_out(self) -> tuple[str, ...]:
        """Names of the test cameras."""
        return tuple(stream.name for stream in self.streams if stream.number in self.cfg.test_cameras)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels, before downscaling."""
        return self.streams[0].size

    @property
    def shape(self) -> tuple[int, int]:
        """(width, height) of training images."""
        return self.size[0] // self.cfg.downscale, self.size[1] // self.cfg.downscale

    @property
    def rate(self) -> float:
        """Frames per unit of the files' time: per second in videos."""
        return self.streams[0].rate

    @property
    def playback_rate(self) -> float:
        """Frames a second of rendered videos."""
        return self.rate if PLAYBACK_RATES[0] <= self.rate <= PLAYBACK_RATES[1] else FRAMES_PER_UNIT

    def first_images(self, undistortion: Mapping[str, Lens] | None = None) -> dict[str, np.ndarray]:
        """Name -> the first frame in use of each camera, (height, width, 3) uint8 RGB at full size, undistorted."""

        def first(stream: Stream) -> np.ndarray:
            image = next(iter(stream.read(1)))
            lens = (undistortion or {}).get(stream.name)
            return undistort(image, lens.maps(stream.size)) if lens and lens.bends else image

        with ThreadPoolExecutor(thread_count(self.threads)) as pool:
            return dict(zip(self.names, pool.map(first, self.streams)))

    def to_scene(
        self,
        cameras: Mapping[str, Camera],
        undistortion: Mapping[str, Lens] | None = None,
        unit: float = 1.0,
        init_box: Box | None = None,
        colors: Mapping[str, ColorCorrection] | None = None,
        estimated: bool = False,
    ) -> Scene:
        """The scene with `cameras` (name -> camera of the full-size image); decodes frames that are not in the store.

        undistortion: name -> lens of the distorted images; `cameras` are those of the undistorted ones. unit: world
        units per normalised unit. init_box: None: a cube around the cameras. colors: of the cameras whose colours are
        corrected, held-out ones included. estimated: whether the poses are of a unit of length of their own, so that
        no depth is known. SceneError, before decoding, if the scene is invalid.
        """
        cfg = self.cfg
        self._check_cameras(cameras)
        undistortion = {name: lens for name, lens in (undistortion or {}).items() if lens.bends}
        small = {
            name: make_camera(self.source / name, partial(reduced_camera, cameras[name], cfg.downscale))
            for name in self.names
        }
        init_box = init_box or _camera_cube(list(small.values()), unit)
        # All checks but those of pixels, with blank images, before the long decoding.
        camera = small[self.names[0]]
        blank = np.broadcast_to(np.uint8(0), (camera.height, camera.width, 3))
        truth = {
            stream.name: self._truth(stream, estimated) for stream in self.streams if stream.name not in undistortion
        }
        masks = {
            name: imaged(undistortion.get(name), self.size, (one.width, one.height)) for name, one in small.items()
        }
        blanks = {stream.name: [blank] * stream.count for stream in self.streams}
        validate_scene(self._scene(small, blanks, unit, init_box, truth, masks))

        decoding = Decoding(cfg.first_frame, self.count, cfg.downscale, undistortion, colors or {})
        folder = decoding.folder(Path(cfg.cache), cfg.name, self.content)
        images = decode(self.streams, folder, decoding, thread_count(self.threads), self.log)
        for stream in self.streams:
            if isinstance(stream, FilmStream):
                keep_film(stream.path, Path(cfg.cache))
        return validate_scene(self._scene(small, images, unit, init_box, truth, masks))

    def _truth(self, stream: Stream, estimated: bool) -> list[StoredTruth] | None:
        """The ground truth of a camera's frames in use; None without one, and where frames are scaled or cropped."""
        file, numbers = self.source / "truth" / f"{stream.name}.npz", stream.ticks
        if isinstance(stream, FilmStream):
            numbers = stream.indices if stream.film.size == stream.size else ()
        if not numbers or not file.is_file():
            return None
        return [StoredTruth(file, number, self.cfg.downscale, has_depth=not estimated) for number in numbers]

    @property
    def mixed_lenses(self) -> bool:
        """Whether cameras differ in size, so that they cannot share a lens."""
        films = [stream.film for stream in self.streams if isinstance(stream, FilmStream)]
        return not all(padded(film.size, films[0].size) for film in films)

    def _check_cameras(self, cameras: Mapping[str, Camera]) -> None:
        for stream in self.streams:
            camera = cameras.get(stream.name)
            if camera is None:
                raise SceneError(
                    stream.path, "a pose for each camera", f"none; {drop_advice(stream.number, self.cfg.drop_cameras)}"
                )
            if (camera.width, camera.height) != self.size:
                raise SceneError(
                    stream.path, "a camera of {} x {} pixels".format(*self.size), f"{camera.width} x {camera.height}"
                )
        if min(self.size) < self.cfg.downscale:
            raise SceneError(
                self.source, f"at least {self.cfg.downscale} pixels a side (downscale)", "{} x {}".format(*self.size)
            )

    def _scene(
        self,
        cameras: Mapping[str, Camera],
        images: Mapping[str, Sequence[Image]],
        unit: float,
        init_box: Box,
        known: Mapping[str, Sequence[StoredTruth] | None],
        masks: Mapping[str, np.ndarray | None],
    ) -> Scene:
        views: dict[str, list[View]] = {"train": [], "test": []}
        for stream in self.streams:
            split = "test" if stream.name in self.held_out else "train"
            truth = known.get(stream.name)
            views[split] += [
                View(
                    cameras[stream.name],
                    stream.times[index],
                    image,
                    f"{split}/{stream.name}_{stream.ticks[index]:04d}",
                    truth=None if truth is None else truth[index],
                    mask=masks[stream.name],
                    filmed_by=stream.name,
                )
                for index, image in enumerate(images[stream.name])
            ]
        train, test = tuple(views["train"]), tuple(views["test"])
        return Scene(
            name=self.cfg.name,
            train=train,
            test=test,
            duration=max(self.count / self.rate, *(stream.times[-1] for stream in self.streams)),
            time_start=0.0,
            background=background_color(self.cfg.background) or BLACK,
            extent=camera_extent([view.camera for view in train]),
            init_box=init_box,
            source=self.source,
            capture=capture_of(train, test, filmed=True),
            unit=unit,
            frame_rate=self.rate,
            playback_rate=self.playback_rate,
            test_split="camera " + ", ".join(map(str, sorted(self.cfg.test_cameras))),
        )


def _camera_cube(cameras: Sequence[Camera], unit: float) -> Box:
    """A cube around the cameras with a margin, for data without depth bounds."""
    positions = np.stack([camera.position for camera in cameras])
    return bounding_cube(positions, margin=max(0.5 * float(np.ptp(positions, axis=0).max()), unit))
