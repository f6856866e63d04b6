"""Encodes one camera's frames as H.264 in an mp4 file, with reproducible bytes."""

from __future__ import annotations

import subprocess
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from imageio_ffmpeg import get_ffmpeg_exe

FRAME_RATE = 30  # a second, as the Plenoptic Video data set
# Constant rate factor of x264. Mean error of `counter` at 320 pixels' width, decoded by OpenCV: 2.0 levels of 255 at 0
# (chroma subsampling and OpenCV's conversion), 2.4 at 8, 2.7 at 12.
QUALITY = 8
# ITU-R BT.601, limited range: decoders assume it without tags, so that those that ignore the tags agree too.
COLOUR_OPTIONS = (
    "-vf scale=out_color_matrix=bt601:out_range=tv:flags=bicubic+accurate_rnd+bitexact "
    "-colorspace smpte170m -color_primaries smpte170m -color_trc smpte170m -color_range tv"
)
# One thread, and no version or date in the file: the same frames give the same bytes.
BITEXACT_OPTIONS = "-threads 1 -fflags +bitexact -flags:v +bitexact"


def write_video(path: Path, frames: Iterable[np.ndarray], width: int, height: int) -> None:
    """Frames (height, width, 3) uint8 at FRAME_RATE; width and height even. Raises OSError if ffmpeg fails."""
    command = [
        get_ffmpeg_exe(),
        *f"-v error -y -f rawvideo -pix_fmt rgb24 -s {width}x{height} -r {FRAME_RATE} -i - -an".split(),
        *COLOUR_OPTIONS.split(),
        *f"-c:v libx264 -preset veryfast -crf {QUALITY} -pix_fmt yuv420p".split(),
        *BITEXACT_OPTIONS.split(),
        str(path),
    ]
    # "-v error" writes a few lines, which fit the pipe's buffer and can be read at the end.
    encoder = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    assert encoder.stdin is not None  # it is a pipe
    try:
        for frame in frames:
            encoder.stdin.write(np.ascontiguousarray(frame).data)
    except BrokenPipeError:
        pass  # ffmpeg ended early; its message is raised below
    except BaseException:
        encoder.kill()
        raise
    finally:
        _, message = encoder.communicate()
    if encoder.returncode != 0:
        reason = " ".join(message.decode(errors="replace").split())
        raise OSError(f"{path}: expected ffmpeg to write it, found exit status {encoder.returncode}: {reason}")
