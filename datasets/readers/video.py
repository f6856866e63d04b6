"""Reader of videos without poses, which structure from motion finds: one clip, or several cameras.

CLIP.mp4, or a folder with one video, or with images in order     one camera that moves (datasets/clip)
DIR/left.mp4, right.mp4, …    several that stand still (datasets/plenoptic), or of which some move (datasets/clip)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from datasets.cameras.lens import Undistortion
from datasets.clip.clips import Clips, cameras_move, is_clip, open_clip, open_clips
from datasets.files.contents import refuse_no_video
from datasets.plenoptic.filmed import FilmedSource, footage_of, read_videos, videos_config
from datasets.plenoptic.footage import Footage
from datasets.plenoptic.unsynchronised import is_synchronised, offsets_of
from datasets.plenoptic.videos import find_footage, video_paths
from datasets.scene import Scene
from datasets.settings import SceneConfig
from datasets.source import Calibration, Log, Photograph, Size, Source, data_path, without_validation
from datasets.video_files.image_folder import image_paths

TITLE, PRECEDENCE = "videos or images without poses", 80


def matches(path: Path) -> str | None:
    if video_paths(path) or image_paths(path):
        return None
    inner = path / "images"
    hint = f"; scene.path={inner} takes its images for one clip" if inner.is_dir() and image_paths(inner) else ""
    return f"no videos and no images{hint}"


def open_source(cfg: SceneConfig, threads: int, log: Log) -> Source:
    path = data_path(cfg)
    refuse_no_video(path)
    if is_clip(path):
        cfg = without_validation(cfg, "clips (scene.test_every holds out other frames)")
        return ClipSource(cfg, lambda: open_clip(path, cfg, log))
    if cfg.moving_cameras and cameras_move(path, cfg):
        cfg = without_validation(cfg, "clips (scene.test_every and scene.test_cameras hold out other views)")
        return ClipSource(cfg, lambda: open_clips(path, cfg, log), several_videos=True)
    cfg = videos_config(cfg)
    return FootageSource(cfg, read_footage(path, cfg, threads, log))


@dataclass(frozen=True)
class ClipSource(Source):
    """The video of one camera that moves, or those of several of which some do, in one reconstruction."""

    cfg: SceneConfig
    open: Callable[[], Clips]  # reads the frames in use
    several_videos: bool = False
    poses = "of every frame"
    points = "sfm"

    @cached_property
    def clips(self) -> Clips:
        return self.open()

    @property
    def path(self) -> Path:
        return self.clips.source

    @property
    def held_out(self) -> tuple[str, ...]:
        return tuple(clip.name for clip in self.clips.cameras if clip.number in self.clips.test_cameras)

    def photographs(self) -> list[Photograph]:
        return [
            Photograph(name, clip.photograph(frame), lens=clip.name, time=clip.time(frame))
            for name, clip, frame in self.clips.photographs()
        ]

    def scene(self, found: Calibration | None = None) -> Scene:
        assert found is not None
        return self.clips.to_scene(found.cameras, found.radial, found.unit, found.colors)

    def size(self) -> Size:
        return Size(*self.clips.counts(), *self.clips.size)


@dataclass(frozen=True)
class FootageSource(FilmedSource):
    """Videos of cameras that stand still: their first frames have the poses and points of all times."""

    cfg: SceneConfig
    footage: Footage
    poses = "estimated"
    guessed_box = True  # a cube around the cameras

    @property
    def one_lens(self) -> bool:
        return not self.footage.mixed_lenses

    def photographs(self) -> list[Photograph]:
        """The distorted first frames; decoding then undistorts all frames."""
        images = self.footage.first_images()
        return [Photograph(name, image, held_out=name in self.held_out) for name, image in images.items()]

    def scene(self, found: Calibration | None = None) -> Scene:
        assert found is not None
        lenses = {name: Undistortion.of(camera, found.radial[name]) for name, camera in found.cameras.items()}
        return self.footage.to_scene(found.cameras, lenses, found.unit, colors=found.colors, estimated=True)


def read_footage(root: Path, cfg: SceneConfig, threads: int, log: Log) -> Footage:
    """The videos of cameras that stand still, of any names.

    Where no camera has the number 0, the default of scene.test_cameras, that of the lowest number is held out.
    """
    files = find_footage(root)
    numbers = {file.number for file in files}
    if not all(file.name.endswith(str(file.number)) for file in files):
        places = ", ".join(f"{file.number} {file.name}" for file in files)
        log(f"cameras are numbered by their place in the order of names: {places}")
    elif list(cfg.test_cameras) == [0] and 0 not in numbers:
        first = min(numbers - set(cfg.drop_cameras), default=0)
        cfg = replace(cfg, test_cameras=[first])
        log(f"no camera has the number 0: camera {first} is held out (scene.test_cameras)")
    videos = read_videos(root, files, cfg, threads)
    offsets = None if cfg.sync == "none" else offsets_of(root, videos, cfg.sync, cfg.offsets, log)
    if offsets is not None and is_synchronised(videos, offsets):
        log("less than half a frame apart: taken as synchronised")
        offsets = None
    return footage_of(root, files, videos, offsets, cfg, threads, log)
