"""Several cameras that filmed one scene at the same time: from files on disk to a `Scene`, once poses are known.

The one way all forms of the layout take: videos or folders of images, with poses that came with them or were found.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datasets.cameras.lens import Undistortion, straighten
from datasets.canonical import FRAMES_A_UNIT
from datasets.plenoptic.decode import Recipe, Stream, decode, reduce_camera, store_folder
from datasets.plenoptic.display import Log
from datasets.plenoptic.sync import drop_advice
from datasets.scene import Box, Image, Scene, SceneError, View, camera_extent, camera_of, cube_round, validate_scene
from rasterizer.camera import Camera
from rasterizer.cores import thread_count

# Images may count time in frames or milliseconds: a rate beyond these is none of a film in seconds.
FILM_RATES = (5.0, 1000.0)


@dataclass(frozen=True)
class Reading:
    """How footage is read; scene.* of the configuration. Lists and strings become tuples and paths."""

    name: str  # of the scene
    downscale: int = 2
    test_cameras: Sequence[int] = (0,)  # held out
    drop_cameras: Sequence[int] = ()  # left out altogether
    first_frame: int = 0
    frames: int = 300  # at most so many
    cache: str | Path = "results/cache"  # the decoded frames are kept under it
    background: Sequence[float] = (0.0, 0.0, 0.0)  # RGB in [0, 1], under what is transparent
    threads: int = 0  # 0: as many as there are cores
    log: Log = print

    def __post_init__(self) -> None:
        for name, value in (
            ("test_cameras", tuple(self.test_cameras)),
            ("drop_cameras", tuple(self.drop_cameras)),
            ("cache", Path(self.cache)),
            ("background", tuple(float(c) for c in self.background)),
        ):
            object.__setattr__(self, name, value)

    @property
    def cores(self) -> int:
        return thread_count(self.threads)


@dataclass(frozen=True)
class Footage:
    """Cameras whose headers agree; nothing is decoded yet, poses may still be unknown."""

    source: Path  # the folder
    streams: tuple[Stream, ...]  # the cameras in use
    count: int  # frames in use of each
    content: str  # hash of all files in the folder
    reading: Reading

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(stream.name for stream in self.streams)

    @property
    def numbers(self) -> tuple[int, ...]:
        """As in scene.test_cameras and scene.drop_cameras."""
        return tuple(stream.number for stream in self.streams)

    @property
    def held_out(self) -> tuple[str, ...]:
        """Names of the test cameras."""
        return tuple(stream.name for stream in self.streams if stream.number in self.reading.test_cameras)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels, before downscaling."""
        return self.streams[0].size

    @property
    def rate(self) -> float:
        """Frames a second, or in what unit of time the files have."""
        return self.streams[0].rate

    @property
    def shown_rate(self) -> float:
        """Frames a second to show it at."""
        return self.rate if FILM_RATES[0] <= self.rate <= FILM_RATES[1] else FRAMES_A_UNIT

    def first_images(self, undistortion: Mapping[str, Undistortion] | None = None) -> dict[str, np.ndarray]:
        """Name -> the first frame in use of each camera, (height, width, 3) uint8 RGB at full resolution; straight
        where there is a lens to straighten."""

        def first(stream: Stream) -> np.ndarray:
            image = next(iter(stream.read(self.reading.first_frame, 1, 1)))
            lens = (undistortion or {}).get(stream.name)
            return straighten(image, lens.maps(stream.size)) if lens and any(lens.coefficients) else image

        with ThreadPoolExecutor(self.reading.cores) as pool:
            return dict(zip(self.names, pool.map(first, self.streams)))

    def to_scene(
        self,
        cameras: Mapping[str, Camera],
        undistortion: Mapping[str, Undistortion] | None = None,
        unit: float = 1.0,
        init_box: Box | None = None,
    ) -> Scene:
        """The scene seen by `cameras` (name -> camera of the full-size image), decoding what is not in the store.

        undistortion: name -> lens, for images that are to be straightened; their cameras are those of the straight
        image. unit: world units of one normalised unit. init_box: None for a cube round the cameras. The scene is
        checked before a frame is decoded.
        """
        reading = self.reading
        self._check_cameras(cameras)
        undistortion = {name: lens for name, lens in (undistortion or {}).items() if any(lens.coefficients)}
        small = {
            name: camera_of(self.source / name, lambda: reduce_camera(cameras[name], reading.downscale))
            for name in self.names
        }
        init_box = init_box or _cube_round(list(small.values()), unit)
        # Not one pixel is needed to see whether the scene can be trained on.
        camera = small[self.names[0]]
        blank = np.broadcast_to(np.uint8(0), (camera.height, camera.width, 3))
        validate_scene(self._scene(small, {name: [blank] * self.count for name in self.names}, unit, init_box))

        recipe = Recipe(reading.first_frame, self.count, reading.downscale)
        folder = store_folder(reading.cache, reading.name, self.content, recipe, undistortion)
        images = decode(self.streams, folder, recipe, undistortion, reading.cores, reading.log)
        return validate_scene(self._scene(small, images, unit, init_box))

    def _check_cameras(self, cameras: Mapping[str, Camera]) -> None:
        for stream in self.streams:
            camera = cameras.get(stream.name)
            if camera is None:
                raise SceneError(
                    stream.path,
                    "a pose for each camera",
                    f"none; {drop_advice(stream.number, self.reading.drop_cameras)}",
                )
            if (camera.width, camera.height) != self.size:
                raise SceneError(
                    stream.path, "a camera of {} x {} pixels".format(*self.size), f"{camera.width} x {camera.height}"
                )
        if min(self.size) < self.reading.downscale:
            raise SceneError(
                self.source,
                f"at least {self.reading.downscale} pixels a side (downscale)",
                "{} x {}".format(*self.size),
            )

    def _scene(
        self, cameras: Mapping[str, Camera], images: Mapping[str, Sequence[Image]], unit: float, init_box: Box
    ) -> Scene:
        views: dict[str, list[View]] = {"train": [], "test": []}
        for stream in self.streams:
            split = "test" if stream.name in self.held_out else "train"
            views[split] += [
                View(
                    cameras[stream.name],
                    index / self.rate,
                    image,
                    f"{split}/{stream.name}_{self.reading.first_frame + index:04d}",
                )
                for index, image in enumerate(images[stream.name])
            ]
        train, test = tuple(views["train"]), tuple(views["test"])
        return Scene(
            name=self.reading.name,
            train=train,
            test=test,
            duration=self.count / self.rate,
            time_start=0.0,
            background=self.reading.background,
            extent=camera_extent([view.camera for view in train]),
            init_box=init_box,
            source=self.source,
            unit=unit,
            frame_rate=self.rate,
            shown_rate=self.shown_rate,
        )


def _cube_round(cameras: Sequence[Camera], unit: float) -> Box:
    """A cube that holds the cameras with room to spare: nothing says how far the scene reaches."""
    positions = np.stack([camera.position for camera in cameras])
    return cube_round(positions, margin=max(0.5 * float(np.ptp(positions, axis=0).max()), unit))
