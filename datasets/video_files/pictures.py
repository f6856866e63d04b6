"""The pictures of a video in the order of display, as FFmpeg decodes them; which are damaged; interlaced ones made
progressive.

A cover picture is no film. After a damaged packet pictures count as damaged until the next key frame.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import av
import av.error
import av.logging
from av.container import InputContainer
from av.filter import Graph
from av.stream import Disposition
from av.video.stream import VideoStream

from datasets.files.errors import SceneError

av.logging.set_level(None)  # errors are reported in one SceneError

NO_FILM = Disposition.attached_pic | Disposition.timed_thumbnails | Disposition.still_image
MOST_THREADS = 16  # more keep more frames in memory and are not faster
HOLE = bytes(16)  # H.264 and H.265 never have more than two zero bytes in a row, or a few more before a length
SEAM = 2  # packets that the parser is behind where it finds bytes missing
RESTARTING = 0x200  # AVFMT_TS_DISCONT: time stamps of such containers begin anywhere, and may jump


@dataclass(frozen=True)
class Picture:
    """A decoded picture."""

    frame: av.VideoFrame
    damaged: bool
    lost: int  # packets before it that gave no picture, since the picture before


def open_container(path: Path) -> InputContainer:
    """The opened file; SceneError if it is none."""
    try:
        return av.open(f"file:{path}")  # a colon in a name is no protocol
    except (av.error.FFmpegError, OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise SceneError(path, "a video", f"a file that cannot be opened as one ({reason})") from None


def film_stream(path: Path, container: InputContainer) -> VideoStream:
    """The stream that a player shows; SceneError for sound alone, with a cover or without, or an unknown codec."""
    films = [stream for stream in container.streams.video if not stream.disposition & NO_FILM]
    if not films:
        found = "a cover picture alone" if container.streams.video else "no picture in it"
        raise SceneError(path, "a video", f"{found}: a sound file?")
    best = container.streams.best("video")
    shown = next((stream for stream in films if best is not None and stream.index == best.index), films[0])
    if shown.codec_context is None:
        raise SceneError(path, "a video in a format that FFmpeg decodes", "another, or a damaged header")
    return shown


def clock_start(container: InputContainer) -> float:
    """Seconds of the file's time stamps at which its clock starts; 0 where the format's stamps begin at 0."""
    return (container.start_time or 0) / av.time_base if container.format.flags & RESTARTING else 0.0


def pictures(container: InputContainer, stream: VideoStream, threads: int) -> Iterator[Picture]:
    """All that are shown, in order. A file that ends early just ends."""
    stream.thread_type, stream.thread_count = ("AUTO" if threads > 1 else "SLICE"), min(threads, MOST_THREADS)
    lost, number, numbers = 0, 0, dict[int | None, int]()  # of packets by the stamps of their pictures
    bad: int | None = None  # the last damaged packet, until a key frame after it
    for number, (packet, bytes_lost) in enumerate(_packets(container, stream)):
        numbers[packet.pts] = number
        if bytes_lost:
            bad = number
        try:
            decoded = packet.decode()
        except av.error.FFmpegError:
            bad, lost = number, lost + 1
            continue
        for frame in decoded:
            if isinstance(frame, av.VideoFrame):
                at = number if frame.pts is None else numbers.get(frame.pts, number)
                if frame.is_corrupt:
                    bad = max(at, bad or 0)
                elif bad is not None and frame.key_frame and at > bad:
                    bad = None
                yield Picture(frame, bad is not None, lost)
                lost = 0


def _packets(container: InputContainer, stream: VideoStream) -> Iterator[tuple[av.Packet, bool]]:
    """The packets in order of decoding, and whether bytes were lost there: not at the seam of a joined file, which
    looks the same, but where time jumps back.
    """
    without_holes = stream.codec_context.name in ("h264", "hevc")
    ahead: deque[av.Packet] = deque()
    packets = _until_cut(container.demux(stream))
    while True:
        while len(ahead) <= SEAM and (packet := next(packets, None)) is not None:
            ahead.append(packet)
        if not ahead:
            return
        packet = ahead.popleft()
        stamps = [other.dts for other in (packet, *ahead) if other.dts is not None]
        hole = without_holes and HOLE in bytes(packet)
        yield packet, hole or (packet.is_corrupt and stamps == sorted(stamps))


def _until_cut(packets: Iterator[av.Packet]) -> Iterator[av.Packet]:
    with suppress(av.error.FFmpegError):  # truncated
        yield from packets


def progressive(shown: Iterator[Picture]) -> Iterator[Picture]:
    """The same, without the comb of interlaced frames: the first field's moment, as bwdif fills in the other's lines.

    Progressive frames are left as they are. Damaged pictures are no neighbours that lines are taken from.
    """
    waiting: list[Picture] = []
    graph: Graph | None = None

    def ready() -> Iterator[Picture]:
        while graph is not None and waiting:
            try:
                frame = graph.vpull()
            except (av.error.BlockingIOError, av.error.EOFError):
                return
            source = waiting.pop(0)
            yield Picture(frame, source.damaged, source.lost)

    for picture in shown:
        if picture.damaged:
            if graph is not None:
                graph.vpush(None)
                yield from ready()
                graph = None
            yield picture
            continue
        if graph is None:
            graph = _deinterlacer(picture.frame)
        waiting.append(picture)
        graph.vpush(picture.frame)
        yield from ready()
    if graph is not None:
        graph.vpush(None)
        yield from ready()


def _deinterlacer(frame: av.VideoFrame) -> Graph:
    graph = Graph()
    source = graph.add_buffer(
        width=frame.width, height=frame.height, format=frame.format, time_base=frame.time_base, name="in"
    )
    graph.link_nodes(source, graph.add("bwdif", "send_frame:auto:interlaced"), graph.add("buffersink")).configure()
    return graph
