"""Writes one camera's frames as H.264 in an mp4 file."""

from __future__ import annotations

import subprocess
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from imageio_ffmpeg import get_ffmpeg_exe

FRAME_RATE = 30  # a second, as the Plenoptic Video data set
# Constant rate factor of x264, 0 is lossless. Of the scene `counter` at 320 pixels' width, decoded by OpenCV, a frame
# is off by 2.4 levels on average at 8, by 2.7 at 12, and by 2.0 at 0: colour at half the resolution, and OpenCV's
# conversion, which rounds down.
QUALITY = 8
# ITU-R BT.601, 16 to 235: what readers take an untagged video for, so that those that ignore the tags agree too.
COLOURS = [
    "-vf",
    "scale=out_color_matrix=bt601:out_range=tv:flags=bicubic+accurate_rnd+bitexact",
    "-colorspace",
    "smpte170m",
    "-color_primaries",
    "smpte170m",
    "-color_trc",
    "smpte170m",
    "-color_range",
    "tv",
]
# One thread and no versions or dates in the file: the same frames give the same bytes.
REPEATABLE = ["-threads", "1", "-fflags", "+bitexact", "-flags:v", "+bitexact"]


def write_video(path: Path, frames: Iterable[np.ndarray], width: int, height: int) -> None:
    """Frames (height, width, 3) uint8 at FRAME_RATE; width and height even. Raises OSError if ffmpeg fails."""
    command = [
        get_ffmpeg_exe(),
        "-v",
        "error",
        "-y",
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgb24",
        "-s",
        f"{width}x{height}",
        "-r",
        str(FRAME_RATE),
        "-i",
        "-",
        "-an",
        *COLOURS,
        "-c:v",
        "libx264",
        "-preset",
        "veryfast",
        "-crf",
        str(QUALITY),
        "-pix_fmt",
        "yuv420p",
        *REPEATABLE,
        str(path),
    ]
    # At "-v error" it says a line or two: less than the pipe holds, so that it can be read at the end.
    encoder = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    try:
        for frame in frames:
            encoder.stdin.write(np.ascontiguousarray(frame).data)
    except BrokenPipeError:
        pass  # it has ended early and says why
    except BaseException:
        encoder.kill()
        raise
    finally:
        _, message = encoder.communicate()
    if encoder.returncode != 0:
        said = " ".join(message.decode(errors="replace").split())
        raise OSError(f"{path}: expected ffmpeg to write it, found exit status {encoder.returncode}: {said}")
