"""`FilmedSource`: videos or image sequences of cameras that stand still, and how their headers are read."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from datasets.composition import chosen_downscale
from datasets.plenoptic.decode import fingerprint
from datasets.plenoptic.footage import Footage
from datasets.plenoptic.sync import common_frames, select_cameras
from datasets.plenoptic.videos import Video, VideoFile, probe
from datasets.settings import SceneConfig
from datasets.source import Log, Size, Source, without_validation

VIDEO_PART = 1 << 20  # bytes hashed at the beginning and at the end of each file
TIMED_FRAMES = 12


class FilmedSource(Source):
    """A source with `footage`, whose frames are decoded into the cache."""

    footage: Footage
    several_videos = True
    points = "sfm"

    @property
    def path(self) -> Path:
        return self.footage.source

    @property
    def held_out(self) -> tuple[str, ...]:
        return self.footage.held_out

    def size(self) -> Size:
        held_out = len(self.held_out) * self.footage.count
        return Size(len(self.footage.names) * self.footage.count - held_out, held_out, *self.footage.shape)

    @property
    def stored_bytes(self) -> int:
        width, height = self.footage.shape
        return 3 * width * height * len(self.footage.names) * self.footage.count

    def seconds_per_frame(self) -> float:
        started, count = time.perf_counter(), min(TIMED_FRAMES, self.footage.count)
        for _ in self.footage.streams[0].read(self.footage.cfg.first_frame, count, 1):
            pass
        return (time.perf_counter() - started) / count


def videos_config(cfg: SceneConfig) -> SceneConfig:
    """`cfg`; SceneError for a validation split of photographs."""
    return without_validation(
        cfg, f"the multi-camera videos of {cfg.name} (scene.test_cameras holds out another camera)"
    )


def open_videos(
    root: Path, files: Sequence[VideoFile], cfg: SceneConfig, log: Log, square: bool = True
) -> tuple[Video, ...]:
    """The videos of the cameras in use, with a line for what is done to their frames. square: see videos.probe."""
    keep = select_cameras([file.number for file in files], root, cfg.test_cameras, cfg.drop_cameras)
    videos = probe(files, keep, cfg.drop_cameras, square)
    for video in videos:
        for note in video.header.notes():
            log(f"{video.path.name}: {note}")
    return videos


def footage_of(
    root: Path, files: Sequence[VideoFile], videos: tuple[Video, ...], cfg: SceneConfig, threads: int, log: Log
) -> Footage:
    """Synchronised videos. files: of all cameras, dropped ones included."""
    count = common_frames(videos, cfg.first_frame, cfg.frames, cfg.drop_cameras)
    if not cfg.downscale:
        cfg = replace(cfg, downscale=chosen_downscale(videos[0].size))
    return Footage(root, videos, count, content_of(files, videos), cfg, threads, log)


def content_of(files: Sequence[VideoFile], videos: Sequence[Video]) -> str:
    """Hash of all files, and whether frames are converted: stores of earlier versions hold the pixels as stored."""
    converted = " converted" if any(video.converted for video in videos) else ""
    return fingerprint([file.path for file in files], VIDEO_PART) + converted
