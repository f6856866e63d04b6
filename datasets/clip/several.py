"""Several cameras of one event, of which some move: a clip each, on one clock, in pictures of one size."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from datasets.cameras.color import ColorCorrection
from datasets.cameras.lens import Undistortion, imaged, undistort
from datasets.clip.footage import FEWEST_FRAMES, Clip, ClipFrame, playback_rate, scene_of_views, survey_clip
from datasets.clip.survey import stands_still
from datasets.composition import BLACK, background_color
from datasets.files.errors import SceneError
from datasets.plenoptic.sync import select_cameras
from datasets.plenoptic.unsynchronised import offsets_of
from datasets.plenoptic.videos import VideoFile, find_footage, probe
from datasets.scene import Scene, View
from datasets.settings import SceneConfig
from datasets.source import Log
from datasets.validation import ordinal
from rasterizer.camera import Camera


@dataclass(frozen=True)
class MovingCamera:
    """One camera of the set: its frames in use."""

    name: str  # of its file, without the suffix
    number: int  # as in scene.test_cameras and scene.drop_cameras
    clip: Clip
    start: float  # seconds of the common clock
    drift: float  # seconds of the common clock per second of its own, less 1
    still: bool

    def time(self, frame: ClipFrame) -> float:
        """On the common clock, seconds."""
        return self.start + frame.time * (1 + self.drift)

    def photograph(self, frame: ClipFrame) -> str:
        """Name of the photograph that has the frame's pose: of a camera that stands still one for all frames."""
        return f"{self.number:02d}_{(self.clip.frames[0] if self.still else frame).name}"


@dataclass(frozen=True)
class ClipSet:
    """The cameras in use; their poses are not known yet."""

    source: Path
    cameras: tuple[MovingCamera, ...]
    cfg: SceneConfig

    @property
    def test_cameras(self) -> Sequence[int]:
        """Numbers of cameras held out as a whole; none: every so many-th frame of each camera is held out."""
        # [0] is the default of cameras that stand still; of those that move every frame is a view of its own.
        return self.cfg.test_cameras if _holds_out_cameras(self.cfg) else ()

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of training images."""
        clip = self.cameras[0].clip
        return clip.size[0] // clip.downscale, clip.size[1] // clip.downscale

    def counts(self) -> tuple[int, int]:
        """(training views, held-out views), if all poses are found."""
        total = sum(len(camera.clip.frames) for camera in self.cameras)
        held_out = sum(len(self._held_out(camera, len(camera.clip.frames))) for camera in self.cameras)
        return total - held_out, held_out

    def photographs(self) -> Iterator[tuple[str, MovingCamera, ClipFrame]]:
        """(name, camera, frame) of what structure from motion takes."""
        for camera in self.cameras:
            for frame in camera.clip.frames[:1] if camera.still else camera.clip.frames:
                yield camera.photograph(frame), camera, frame

    def to_scene(
        self,
        poses: Mapping[str, Camera],
        radial: Mapping[str, float],
        unit: float,
        colors: Mapping[str, ColorCorrection] | None = None,
    ) -> Scene:
        """The scene of the frames whose photograph has a pose. Other frames are left out.

        radial: camera -> distortion of its lens (OpenCV's k1). unit: world units per normalised unit. colors: of the
        cameras whose colours are corrected.
        """
        views: dict[str, list[View]] = {"train": [], "test": []}
        poses = {name: camera.clip.frame_camera(poses[name]) for name, camera, _ in self.photographs() if name in poses}
        kept = {c.name: [f for f in c.clip.frames if c.photograph(f) in poses] for c in self.cameras}
        times = [camera.time(frame) for camera in self.cameras for frame in kept[camera.name]]
        start, end = min(times), max(times)
        for camera in self.cameras:
            frames, color = kept[camera.name], (colors or {}).get(camera.name)
            held_out = self._held_out(camera, len(frames))
            one = poses[camera.photograph(frames[0])]
            lens = Undistortion.of(one, radial[camera.name]) if radial[camera.name] else None
            size = one.width, one.height
            maps = lens.maps(size) if lens else None
            for index, frame in enumerate(frames):
                split = "test" if index in held_out else "train"
                image = color.apply(frame.image) if color else frame.image
                image = undistort(image, maps) if maps else image
                pose, image = camera.clip.training_view(poses[camera.photograph(frame)], image)
                name = f"{split}/{camera.name}_{frame.name.rpartition('_')[2]}"
                mask = imaged(lens, size, (pose.width, pose.height))
                time = camera.time(frame) - start
                views[split].append(View(pose, time, image, name, mask=mask, filmed_by=camera.name))
        longest = max(self.cameras, key=lambda camera: len(kept[camera.name]))
        return scene_of_views(
            views,
            name=self.cfg.name,
            source=self.source,
            duration=end - start,
            unit=unit,
            rate=playback_rate([frame.time for frame in kept[longest.name]]),
            test_split=self._split(),
            background=background_color(self.cfg.background) or BLACK,
        )

    def _held_out(self, camera: MovingCamera, count: int) -> Sequence[int]:
        """Places among its `count` frames."""
        if self.test_cameras:
            return range(count) if camera.number in self.test_cameras else ()
        return range(self.cfg.test_every // 2, count, self.cfg.test_every)

    def _split(self) -> str:
        if self.test_cameras:
            return "camera " + ", ".join(map(str, sorted(self.test_cameras)))
        return f"every {ordinal(self.cfg.test_every)} frame of each camera"


def cameras_move(root: Path, drop_cameras: Sequence[int], assumed: bool = False) -> bool:
    """Whether several cameras filmed, and one of them does not stand still. SceneError for a folder without videos.

    assumed: they are taken to move without a check.
    """
    files = [file for file in find_footage(root) if file.number not in drop_cameras]
    return len(files) > 1 and (assumed or not all(stands_still(file.path) for file in files))


def open_clip_set(root: Path, cfg: SceneConfig, log: Log) -> ClipSet:
    """Reads the frames in use of all cameras. SceneError for what cannot be used, with what to do instead."""
    files = find_footage(root)
    held_out = cfg.test_cameras if _holds_out_cameras(cfg) else ()
    keep = select_cameras([file.number for file in files], root, held_out, cfg.drop_cameras)
    kept = [file for file in files if file.number in keep]
    still = [cfg.moving_cameras is not True and stands_still(file.path) for file in kept]
    log(_said(kept, still))
    videos = probe(files, keep, cfg.drop_cameras)
    offsets = None
    if cfg.sync != "none":
        moving = not all(still)
        offsets = offsets_of(root, videos, cfg.sync, cfg.offsets, log, moving)
    share = max(FEWEST_FRAMES, cfg.frames // len(kept))
    surveyed = [survey_clip(file.path, cfg, share, log, stands) for file, stands in zip(kept, still, strict=True)]
    size = min(clip.size[0] for clip in surveyed), min(clip.size[1] for clip in surveyed)
    none = (0.0,) * len(kept)
    starts, drifts = (none, none) if offsets is None else (offsets.seconds, offsets.drift)
    cameras = tuple(
        MovingCamera(file.name, file.number, clip.read(size), start, drift, stands)
        for file, clip, start, drift, stands in zip(kept, surveyed, starts, drifts, still, strict=True)
    )
    _refuse_other_times(root, cameras)
    found = ClipSet(root, cameras, cfg)
    if not found.counts()[1]:
        longest = max(len(camera.clip.frames) for camera in cameras)
        raise SceneError(
            f"{root}: scene.test_every", f"below {2 * longest}, twice the frames of a camera", f"{cfg.test_every}"
        )
    return found


def _holds_out_cameras(cfg: SceneConfig) -> bool:
    return cfg.test_every == 0 or list(cfg.test_cameras) != [0]


def _refuse_other_times(root: Path, cameras: Sequence[MovingCamera]) -> None:
    """SceneError for a camera that filmed while no other one did."""
    spans = [(camera.time(camera.clip.frames[0]), camera.time(camera.clip.frames[-1])) for camera in cameras]
    for camera, (start, end) in zip(cameras, spans):
        others = [span for other, span in zip(cameras, spans) if other is not camera]
        if all(end < first or last < start for first, last in others):
            raise SceneError(
                camera.clip.source,
                "frames of the time that another camera filmed",
                f"{start:.2f} to {end:.2f} s; scene.drop_cameras=[{camera.number}] leaves it out",
            )


def _said(files: Sequence[VideoFile], still: Sequence[bool]) -> str:
    """For the user."""
    moving = ", ".join(file.name for file, stands in zip(files, still) if not stands)
    standing = ", ".join(file.name for file, stands in zip(files, still) if stands)
    return f"cameras that move: {moving or 'none'}" + (f"; that stand still: {standing}" if standing else "")
