"""`FilmedSource`: videos or image sequences of cameras that stand still, and how they are opened."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

from datasets.composition import chosen_downscale
from datasets.files.fingerprint import fingerprint
from datasets.plenoptic.align import aligned, left_out, synchronised
from datasets.plenoptic.footage import Footage
from datasets.plenoptic.sync import select_cameras
from datasets.plenoptic.videos import Video, VideoFile, open_videos
from datasets.settings import SceneConfig
from datasets.source import Log, Size, Source, without_validation
from datasets.sync.offsets import Offsets
from datasets.video_files.film import FINGERPRINT_PART

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
        counts = {stream.name: stream.count for stream in self.footage.streams}
        held_out = sum(counts[name] for name in self.held_out)
        return Size(sum(counts.values()) - held_out, held_out, *self.footage.shape)

    @property
    def stored_bytes(self) -> int:
        width, height = self.footage.shape
        return 3 * width * height * sum(stream.count for stream in self.footage.streams)

    def seconds_per_frame(self) -> float:
        started = time.perf_counter()
        count = sum(1 for _ in islice(self.footage.streams[0].read(1), TIMED_FRAMES))
        return (time.perf_counter() - started) / count


def videos_config(cfg: SceneConfig) -> SceneConfig:
    """`cfg`; SceneError for a validation split of photographs."""
    return without_validation(
        cfg, f"the multi-camera videos of {cfg.name} (scene.test_cameras holds out another camera)"
    )


def read_videos(
    root: Path, files: Sequence[VideoFile], cfg: SceneConfig, threads: int, square: bool = True
) -> tuple[Video, ...]:
    """The videos of the cameras in use. square: see open_videos."""
    keep = select_cameras([file.number for file in files], root, cfg.test_cameras, cfg.drop_cameras)
    return open_videos(files, keep, cfg.drop_cameras, Path(cfg.cache), threads, square)


def footage_of(
    root: Path,
    files: Sequence[VideoFile],
    videos: Sequence[Video],
    offsets: Offsets | None,
    cfg: SceneConfig,
    threads: int,
    log: Log,
) -> Footage:
    """Footage with a line a camera for what is mended or left out. files: of all cameras, dropped ones included;
    offsets: None: the time stamps are of one clock.
    """
    if offsets is None:
        streams = synchronised(videos, cfg.first_frame, cfg.frames)
    else:
        streams = aligned(videos, offsets, cfg.first_frame, cfg.frames)
    count = 1 + max(stream.ticks[-1] for stream in streams) - cfg.first_frame
    for video, stream in zip(videos, streams, strict=True):
        missing = left_out(stream, cfg.first_frame, count)
        notes = [*video.film.notes(), *filter(None, (video.film.damage(), missing))]
        if notes:
            log(f"{video.path.name}: {'; '.join(notes)}")
    if not cfg.downscale:
        cfg = replace(cfg, downscale=chosen_downscale(streams[0].size))
    # Which frames are in use depends on the other cameras, too; all else that a store holds is in the files.
    chosen = [(s.name, s.ticks, s.indices, s.size) for s in streams if s.indices != s.ticks or offsets]
    aspects = sorted({video.film.pixel_aspect for video in videos})
    content = f"{fingerprint([file.path for file in files], FINGERPRINT_PART)} {aspects} {chosen}"
    return Footage(root, streams, count, content, cfg, threads, log)
