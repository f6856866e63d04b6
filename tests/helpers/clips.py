"""Writes small clips with PyAV, frames at given times, sound, formats that a phone writes, and opens them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from datasets.clip.clips import open_clip
from datasets.clip.footage import Clip
from datasets.settings import SceneConfig

SIZE = (96, 64)  # of textured_plane, pixels
CLOCK = 90_000  # ticks a second of the files' time
SOUND_RATE = 48_000


def write_clip(
    path: Path,
    frames: Iterable[np.ndarray],
    times: Sequence[float],
    sound: np.ndarray | None = None,
    codec: str = "libx264",
    pixels: str = "yuv420p",
    options: dict[str, str] | None = None,
) -> Path:
    """frames: (H, W, 3) uint8. times: seconds, ascending, from 0. sound: mono in [-1, 1] at SOUND_RATE, from time 0."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=30)
        stream.pix_fmt = pixels
        stream.time_base = stream.codec_context.time_base = Fraction(1, CLOCK)
        stream.options = {"crf": "12", "preset": "ultrafast", **(options or {})}
        audio = None
        if sound is not None:
            audio = container.add_stream("aac", rate=SOUND_RATE, layout="mono")
        for index, (image, time) in enumerate(zip(frames, times)):
            if index == 0:
                stream.height, stream.width = image.shape[:2]
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
            frame.pts, frame.time_base = round(time * CLOCK), Fraction(1, CLOCK)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
        if audio is not None and sound is not None:
            for first in range(0, len(sound), 1024):
                part = sound[None, first : first + 1024].astype(np.float32)
                block = av.AudioFrame.from_ndarray(np.ascontiguousarray(part), format="fltp", layout="mono")
                block.sample_rate, block.pts, block.time_base = SOUND_RATE, first, Fraction(1, SOUND_RATE)
                container.mux(audio.encode(block))
            container.mux(audio.encode(None))
    return path


def textured_plane(shift: float, size: tuple[int, int] = SIZE, seed: int = 0) -> np.ndarray:
    """(H, W, 3): noise that moves to the left by `shift` pixels."""
    width, height = size
    rng = np.random.default_rng(seed)
    coarse = rng.random((height // 4 + 2, 200, 3))
    x = (np.arange(width) + shift) / 4
    y = np.arange(height) / 4
    left, top = np.floor(x).astype(int) % 199, np.floor(y).astype(int)
    fx, fy = (x % 1)[None, :, None], (y % 1)[:, None, None]
    rows = coarse[top] * (1 - fy) + coarse[top + 1] * fy
    return np.rint(255 * (rows[:, left] * (1 - fx) + rows[:, left + 1] * fx)).astype(np.uint8)


def frames(count: int, seed: int = 0, step: float = 1.5) -> list[np.ndarray]:
    """Of a camera that pans by `step` pixels a frame."""
    return [textured_plane(step * i, SIZE, seed) for i in range(count)]


def opened(path: Path, **options: int) -> tuple[Clip, str]:
    """The clip, and everything that was said of it."""
    lines: list[str] = []
    cfg = SceneConfig("clip", "video", **{"downscale": 0, **options})
    return open_clip(path, cfg, lines.append).cameras[0], "\n".join(lines)
