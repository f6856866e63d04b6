"""One camera that moves, or several of one event of which some do: a clip each, on one clock, in pictures of one size.

Their cameras come later, from structure from motion.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from datasets.cameras.color import ColorCorrection
from datasets.cameras.lens import Undistortion, imaged, undistort
from datasets.canonical import canonical_space
from datasets.clip.footage import FEWEST_FRAMES, Clip, ClipFrame, survey_clip
from datasets.clip.survey import stands_still
from datasets.composition import BLACK, background_color
from datasets.files.errors import SceneError
from datasets.plenoptic.sync import select_cameras
from datasets.plenoptic.unsynchronised import offsets_of
from datasets.plenoptic.videos import find_footage, open_videos, video_paths
from datasets.scene import USUAL_BOX, Scene, View, camera_extent, capture_of, validate_scene
from datasets.settings import SceneConfig
from datasets.source import Log
from datasets.validation import ordinal
from datasets.video_files.image_folder import image_paths
from rasterizer.camera import Camera

PLAYBACK_RATES = (5.0, 60.0)  # frames a second of rendered videos


@dataclass(frozen=True)
class Clips:
    """The cameras in use; their poses are not known yet."""

    source: Path  # the file, or the folder
    cameras: tuple[Clip, ...]
    test_cameras: Collection[int]  # held out as a whole; none: every so many-th frame of each camera is held out
    cfg: SceneConfig

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of training images."""
        clip = self.cameras[0]
        return clip.size[0] // clip.downscale, clip.size[1] // clip.downscale

    def counts(self) -> tuple[int, int]:
        """(training views, held-out views), if all poses are found."""
        total = sum(len(clip.frames) for clip in self.cameras)
        held_out = sum(len(self._held_out(clip, len(clip.frames))) for clip in self.cameras)
        return total - held_out, held_out

    def photographs(self) -> Iterator[tuple[str, Clip, ClipFrame]]:
        """(name, camera, frame) of what structure from motion takes."""
        for clip in self.cameras:
            for frame in clip.frames[:1] if clip.still else clip.frames:
                yield clip.photograph_name(frame), clip, frame

    def to_scene(
        self,
        poses: Mapping[str, Camera],
        radial: Mapping[str, float],
        unit: float,
        colors: Mapping[str, ColorCorrection] | None = None,
    ) -> Scene:
        """The scene of the frames whose photograph has a pose. Other frames are left out.

        radial: photograph -> distortion of its lens (OpenCV's k1). unit: world units per normalised unit. colors: of
        the cameras whose colours are corrected.
        """
        views: dict[str, list[View]] = {"train": [], "test": []}
        poses = {name: clip.frame_camera(poses[name]) for name, clip, _ in self.photographs() if name in poses}
        kept = [[f for f in clip.frames if clip.photograph_name(f) in poses] for clip in self.cameras]
        times = [clip.time(frame) for clip, frames in zip(self.cameras, kept) for frame in frames]
        start, end = min(times), max(times)
        longest = [frame.time for frame in max(kept, key=len)]
        self.refuse_without_test(len(longest))
        for clip, frames in zip(self.cameras, kept):
            held_out, color = self._held_out(clip, len(frames)), (colors or {}).get(clip.name)
            first = clip.photograph_name(frames[0])
            lens = Undistortion.of(poses[first], radial[first]) if radial[first] else None
            size = poses[first].width, poses[first].height
            maps = lens.maps(size) if lens else None
            for index, frame in enumerate(frames):
                split = "test" if index in held_out else "train"
                image = color.apply(frame.image) if color else frame.image
                image = undistort(image, maps) if maps else image
                pose, image = clip.training_view(poses[clip.photograph_name(frame)], image)
                name = f"{clip.name}_{frame.name.rpartition('_')[2]}" if clip.name else frame.name
                mask = imaged(lens, size, (pose.width, pose.height))
                time = clip.time(frame) - start
                views[split].append(View(pose, time, image, f"{split}/{name}", mask=mask, filmed_by=clip.name))
        train = [view.camera for view in views["train"]]
        rate = (len(longest) - 1) / max(longest[-1] - longest[0], 1e-3)  # at which they last as long as they did
        every = f"every {ordinal(self.cfg.test_every)} frame" + (" of each camera" if len(kept) > 1 else "")
        return validate_scene(
            Scene(
                name=self.cfg.name,
                train=tuple(views["train"]),
                test=tuple(views["test"]),
                duration=end - start,
                time_start=0.0,
                background=background_color(self.cfg.background) or BLACK,
                extent=camera_extent(train),
                init_box=canonical_space(train, unit).inverse.box(USUAL_BOX),
                source=self.source,
                capture=capture_of(views["train"], views["test"], filmed=True),
                unit=unit,
                playback_rate=min(max(rate, PLAYBACK_RATES[0]), PLAYBACK_RATES[1]),
                test_split="camera " + ", ".join(map(str, sorted(self.test_cameras))) if self.test_cameras else every,
            )
        )

    def _held_out(self, clip: Clip, count: int) -> Sequence[int]:
        """Places among its `count` frames."""
        if self.test_cameras:
            return range(count) if clip.number in self.test_cameras else ()
        return range(self.cfg.test_every // 2, count, self.cfg.test_every)

    def refuse_without_test(self, longest: int) -> None:
        """SceneError if no frame would be held out. longest: the most frames of a camera."""
        if not self.test_cameras and self.cfg.test_every // 2 >= longest:
            frames = "frames of a camera" if len(self.cameras) > 1 else "frames in use"
            raise SceneError(
                f"{self.source}: scene.test_every", f"below {2 * longest}, twice the {frames}", f"{self.cfg.test_every}"
            )


def is_clip(path: Path) -> bool:
    """Whether `path` is a video file, or a folder with a single video, or with images and no video."""
    if not path.is_dir():
        return path.is_file()
    videos = video_paths(path)
    return len(videos) == 1 or (not videos and bool(image_paths(path)))


def cameras_move(root: Path, cfg: SceneConfig) -> bool:
    """Whether several cameras filmed, and one of them does not stand still. SceneError for a folder without videos."""
    files = [file for file in find_footage(root) if file.number not in cfg.drop_cameras]
    assumed = cfg.moving_cameras is True
    return len(files) > 1 and (assumed or not all(stands_still(file.path, Path(cfg.cache)) for file in files))


def open_clip(path: Path, cfg: SceneConfig, log: Log) -> Clips:
    """Reads the frames in use of one camera. SceneError for what cannot be used, with what to do instead."""
    if not path.exists():
        raise SceneError(path, "a video, or a folder of videos or of images in order", "nothing there")
    if path.is_dir() and (videos := video_paths(path)):
        path = videos[0]
    if cfg.test_every == 0:
        raise SceneError("scene.test_every", "at least 2 for one camera that moves", "0")
    surveyed = survey_clip(path, cfg, cfg.frames, log)
    found = Clips(path, (surveyed.read(surveyed.size),), (), cfg)
    found.refuse_without_test(len(found.cameras[0].frames))  # before structure from motion
    return found


def open_clips(root: Path, cfg: SceneConfig, log: Log) -> Clips:
    """The same of several cameras."""
    files = find_footage(root)
    # [0] is the default of cameras that stand still; of those that move every frame is a view of its own.
    held_out = cfg.test_cameras if cfg.test_every == 0 or list(cfg.test_cameras) != [0] else ()
    keep = select_cameras([file.number for file in files], root, held_out, cfg.drop_cameras)
    kept = [file for file in files if file.number in keep]
    still = [cfg.moving_cameras is not True and stands_still(file.path, Path(cfg.cache)) for file in kept]
    moving, standing = (", ".join(f.name for f, stands in zip(kept, still) if stands == one) for one in (False, True))
    log(f"cameras that move: {moving or 'none'}" + (f"; that stand still: {standing}" if standing else ""))
    videos = open_videos(files, keep, cfg.drop_cameras, Path(cfg.cache))
    offsets = None
    if cfg.sync != "none":
        offsets = offsets_of(root, videos, cfg.sync, cfg.offsets, log, moving=not all(still))
    share = max(FEWEST_FRAMES, cfg.frames // len(kept))
    surveyed = [survey_clip(file.path, cfg, share, log, stands) for file, stands in zip(kept, still, strict=True)]
    size = min(clip.size[0] for clip in surveyed), min(clip.size[1] for clip in surveyed)
    none = (0.0,) * len(kept)
    starts, drifts = (none, none) if offsets is None else (offsets.seconds, offsets.drift)
    cameras = tuple(
        replace(clip.read(size), name=file.name, number=file.number, start=start, drift=drift, still=stands)
        for file, clip, start, drift, stands in zip(kept, surveyed, starts, drifts, still, strict=True)
    )
    _refuse_other_times(cameras)
    found = Clips(root, cameras, held_out, cfg)
    found.refuse_without_test(max(len(clip.frames) for clip in cameras))
    return found


def _refuse_other_times(cameras: Sequence[Clip]) -> None:
    """SceneError for a camera that filmed while no other one did."""
    spans = [(clip.time(clip.frames[0]), clip.time(clip.frames[-1])) for clip in cameras]
    for clip, (start, end) in zip(cameras, spans):
        others = [span for other, span in zip(cameras, spans) if other is not clip]
        if all(end < first or last < start for first, last in others):
            raise SceneError(
                clip.source,
                "frames of the time that another camera filmed",
                f"{start:.2f} to {end:.2f} s; scene.drop_cameras=[{clip.number}] leaves it out",
            )
