"""What the header and the first frame of a video say; SceneError for what cannot be used."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import av
import av.error
import av.logging

from datasets.files.errors import SceneError

av.logging.set_level(None)  # errors are reported in one SceneError

HDR_TRANSFERS = {16: "PQ (HDR10)", 18: "HLG"}  # of ISO 23091-2: the code points of high dynamic range
USUAL_RATE = 30.0  # frames a second, where a file does not say
SIZE_LIMIT = 16  # pixels a side


@dataclass(frozen=True)
class Header:
    """Of the first video stream. Sizes are upright, as a player shows them."""

    size: tuple[int, int]  # (width, height)
    rotation: int  # degrees that a player turns the stored frames by: 0, 90, 180 or 270
    rate: float  # mean frames a second
    count: int | None  # frames according to the header; None: it does not say
    seconds: float | None
    bits: int  # a channel
    transfer: int  # code point of the transfer function
    pixel_aspect: float  # width / height of a pixel as stored; frames are widened to square pixels

    @property
    def frames(self) -> int:
        """Their number, an estimate where the header does not say."""
        return self.count or round((self.seconds or 0.0) * (self.rate or USUAL_RATE))

    @property
    def hdr(self) -> str | None:
        """The name of the transfer function of high dynamic range; None for ordinary clips."""
        return HDR_TRANSFERS.get(self.transfer)

    def notes(self) -> list[str]:
        """What was done to the frames, a line each, for the user."""
        found = []
        if self.rotation:
            found.append(f"the clip is stored sideways: frames are turned by {self.rotation}°, as its header says")
        if self.hdr:
            found.append(f"the clip is {self.hdr}: highlights are compressed to 8-bit colour (BT.709)")
        elif self.bits > 8:
            found.append(f"the clip has {self.bits} bits a channel: rounded to 8")
        if self.pixel_aspect != 1:
            found.append(
                f"pixels are {self.pixel_aspect:.3g} times as wide as high: frames are scaled to {{}} x {{}}".format(
                    *self.size
                )
            )
        return found


def open_container(path: Path) -> av.container.InputContainer:
    """The opened file; SceneError if it is none, or has no video."""
    try:
        container = av.open(str(path))
    except (av.error.FFmpegError, OSError, ValueError) as error:
        raise SceneError(path, "a video", f"a file that cannot be opened as one ({_reason(error)})") from None
    if not container.streams.video:
        container.close()
        raise SceneError(path, "a video", "no picture in it: a sound file?")
    return container


def probe(path: Path) -> Header:
    """The header of a video and what its first frame adds: rotation and the format of the pixels."""
    with open_container(path) as container:
        stream = container.streams.video[0]
        frame = next((frame for frame in decoded_frames(container) if frame is not None), None)
        if frame is None:
            raise SceneError(path, "a video", "no frame that can be decoded")
        rotation = round(-frame.rotation / 90) * 90 % 360  # the file's angle counts counterclockwise
        ratio = stream.codec_context.sample_aspect_ratio
        aspect = float(ratio) if ratio else 1.0
        width, height = round(frame.width * aspect), frame.height
        if rotation % 180:
            width, height = height, width
        if min(width, height) < SIZE_LIMIT:
            raise SceneError(path, f"at least {SIZE_LIMIT} pixels a side", f"{width} x {height}")
        rate = stream.average_rate or stream.guessed_rate
        seconds = None
        if stream.duration is not None and stream.time_base is not None:
            seconds = float(stream.duration * stream.time_base)
        elif container.duration:
            seconds = container.duration / av.time_base
        return Header(
            (width, height),
            rotation,
            float(rate) if rate else 0.0,
            stream.frames or None,
            seconds,
            max(component.bits for component in frame.format.components),
            int(frame.color_trc),
            aspect,
        )


def decoded_frames(container: av.container.InputContainer) -> Iterator[av.VideoFrame | None]:
    """Decoded frames in order; None for a packet that cannot be decoded. A file that ends early just ends."""
    packets = container.demux(container.streams.video[0])
    while True:
        try:
            packet = next(packets, None)
        except av.error.FFmpegError:  # truncated
            return
        if packet is None:
            return
        try:
            for frame in packet.decode():
                if isinstance(frame, av.VideoFrame):
                    yield frame
        except av.error.FFmpegError:
            yield None


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)
