"""`Film`: what a player shows of a video file, found out by decoding all of it once. No header is believed."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np

from datasets.files.atomic_write import atomic_file
from datasets.files.errors import DataError, SceneError, read_json
from datasets.files.fingerprint import fingerprint
from datasets.video_files.frame import Frame
from datasets.video_files.hdr import tone_mapped
from datasets.video_files.pictures import (
    NO_FILM,
    RESTARTING,
    clock_start,
    film_stream,
    open_container,
    pictures,
    progressive,
)
from datasets.video_files.times import USUAL_RATE, ascending, rate_of, usual_step
from rasterizer.cores import thread_count

HDR_TRANSFERS = {16: "PQ (HDR10)", 18: "HLG"}  # of ISO 23091-2: the code points of high dynamic range
SIZE_LIMIT = 16  # pixels a side
ROUNDED_PIXELS = 2.0  # of the longer side: a program that scaled to whole pixels writes what that changed as an aspect
FILM_VERSION = 2  # to be increased by every change that alters what is kept
FINGERPRINT_PART = 1 << 20  # bytes hashed at the beginning and at the end of each file
UNTURNED = (1, 0, 0, 1)
TURNS = {
    (0, 1, -1, 0): "stored sideways: turned by 90°",
    (-1, 0, 0, -1): "stored upside down: turned by 180°",
    (0, -1, 1, 0): "stored sideways: turned by 270°",
    (-1, 0, 0, 1): "stored mirrored: left and right are swapped",
    (1, 0, 0, -1): "stored mirrored: top and bottom are swapped",
    (0, 1, 1, 0): "stored sideways and mirrored: rows and columns are swapped",
    (0, -1, -1, 0): "stored sideways and mirrored: rows and columns are swapped, and the picture turned by 180°",
}


@dataclass(frozen=True, eq=False)
class Film:
    """What a player shows of a video. Frames are counted from 0 as they are shown."""

    path: Path
    stored: tuple[int, int]  # (width, height) of the stored picture
    turn: tuple[int, int, int, int]  # of the display matrix: (x, y) as stored is shown at (ax + cy, bx + dy)
    pixel_aspect: float  # width / height of a pixel as stored; frames are widened to square pixels
    bits: int  # a channel
    transfer: int  # code point of the transfer function
    interlaced: int  # frames
    times: np.ndarray  # (frames,) seconds of the file's clock, ascending
    intact: np.ndarray  # (frames,) bool
    rate: float  # frames a second, dropped ones counted
    even: bool  # whether all times are at equal steps, or several
    lost: int  # packets that gave no frame
    stamped: bool  # whether the file has times
    continued: int  # times the clock was continued where it jumped
    films: int  # in the file; the one that a player shows is read
    covers: int  # pictures in the file that are no film
    threads: int  # that decoded it

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) as shown."""
        width, height = round(self.stored[0] * self.pixel_aspect), self.stored[1]
        return (width, height) if self.turn[0] else (height, width)

    @property
    def count(self) -> int:
        return len(self.times)

    @property
    def sound(self) -> bool:
        """Whether nothing is damaged. Else what comes out of the decoder depends on its threads."""
        return not self.lost and bool(self.intact.all())

    @property
    def hdr(self) -> str | None:
        """The name of the transfer function of high dynamic range; None for ordinary videos."""
        return HDR_TRANSFERS.get(self.transfer)

    def notes(self) -> list[str]:
        """What was done to the frames and their times, a few words each, for the user."""
        found = []
        if self.films > 1:
            found.append(f"{self.films} films in it, the one that players show is read")
        if self.covers:
            found.append("its cover picture is left out")
        if self.turn != UNTURNED:
            found.append(f"{TURNS[self.turn]}, as its header says")
        if self.interlaced:
            found.append(f"{self.interlaced} of {self.count} frames are interlaced: lines filled in by bwdif")
        if self.hdr:
            found.append(f"{self.hdr}: highlights are compressed to 8-bit colour (BT.709)")
        elif self.bits > 8:
            found.append(f"{self.bits} bits a channel: rounded to 8")
        if self.pixel_aspect != 1:
            found.append(
                f"pixels are {self.pixel_aspect:.3g} times as wide as high: frames are scaled to {{}} x {{}}".format(
                    *self.size
                )
            )
        if not self.stamped:
            found.append(f"no time stamps: {self.rate:g} frames a second are taken")
        if self.continued:
            found.append(f"its clock jumps ({self.continued} x): continued by a step of {1e3 / self.rate:.3g} ms")
        return found

    def damage(self) -> str | None:
        """What is left out as damaged, for the user; None if nothing is."""
        smeared = int((~self.intact).sum())
        lost = f"packets that give no frame: {self.lost}" if self.lost else ""
        if not smeared:
            return lost or None
        left = f"{smeared} of {self.count} frames are damaged, up to the next key frame, and left out"
        return f"{left}; {lost}" if lost else left

    def frames(self, keep: Collection[int] | None = None, every: int = 1, threads: int = 0) -> Iterator[Frame]:
        """The frames, damaged ones without an image. keep: only these; every: only each so many-th; threads 0: all
        cores.
        """
        last = max(keep, default=-1) if keep is not None else self.count - 1
        if last < 0:
            return
        with open_container(self.path) as container:
            shown = pictures(container, film_stream(self.path, container), thread_count(threads) if self.sound else 1)
            for index, picture in enumerate(progressive(shown) if self.interlaced else shown):
                if index % every == 0 and (keep is None or index in keep):
                    image = self._image(picture.frame) if self.intact[index] else None
                    yield Frame(index, float(self.times[index]), image)
                if index >= last:
                    return

    def _image(self, frame: av.VideoFrame) -> np.ndarray:
        """(H, W, 3) uint8 RGB, upright."""
        if self.hdr:
            image = tone_mapped(frame.to_ndarray(format="rgb48le"), self.transfer)
        else:
            image = frame.to_ndarray(format="rgb24")
        a, b, c, d = self.turn
        if self.pixel_aspect != 1.0:
            image = cv2.resize(image, self.size if a else self.size[::-1], interpolation=cv2.INTER_AREA)
        if not a:
            image = image.transpose(1, 0, 2)
        return np.ascontiguousarray(image[:: b + d, :: a + c])


_FILMS: dict[tuple[Path, Path], Film] = {}  # by the file that keeps it and the video: a run asks several times


def open_film(path: Path, cache: Path, threads: int = 0) -> Film:
    """The film of a video; SceneError for what is none. Decodes all of it, unless it was kept in `cache`, or asked for
    before. threads 0: all cores.
    """
    file = _file(path, cache)
    if (file, path) not in _FILMS:
        film = _kept(file, path) or _decoded(path, thread_count(threads))
        # Which pictures damage reaches must not depend on the number of threads.
        _FILMS[file, path] = film if film.sound or film.threads == 1 else _decoded(path, 1)
    return _FILMS[file, path]


def keep_film(path: Path, cache: Path) -> None:
    """Saves other processes the decoding of open_film(path, cache)."""
    file = _file(path, cache)
    if not file.exists():
        film = open_film(path, cache)
        content = {**vars(film), "path": path.name, "times": film.times.tolist(), "intact": film.intact.tolist()}
        file.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(file) as temporary, open(temporary, "w") as opened:
            json.dump(content, opened)


def _kept(file: Path, path: Path) -> Film | None:
    try:
        kept = read_json(file)
        tuples = {name: tuple(kept[name]) for name in ("stored", "turn")}
        arrays = {name: np.array(kept[name]) for name in ("times", "intact")}
        return Film(**{**kept, **tuples, **arrays, "path": path})
    except (OSError, DataError, KeyError, TypeError):
        return None


def _file(path: Path, cache: Path) -> Path:
    """Of a film in the cache, by the video's content and time of change, and by who decodes it."""
    try:
        changed = path.stat().st_mtime_ns
    except OSError as error:
        raise SceneError(path, "a video", f"a file that cannot be opened as one ({error.strerror})") from None
    parts = f"{FILM_VERSION} {av.__version__} {fingerprint([path], FINGERPRINT_PART)} {changed}"
    return cache / "films" / f"{path.stem}-{hashlib.blake2b(parts.encode(), digest_size=6).hexdigest()}.json"


def _decoded(path: Path, threads: int) -> Film:
    first: av.VideoFrame | None = None
    stamps: list[float | None] = []
    intact: list[bool] = []
    interlaced = lost = 0
    with open_container(path) as container:
        stream = film_stream(path, container)
        unit = stream.time_base or Fraction(1, 1_000_000)
        unordered, jumping = container.format.name == "avi", bool(container.format.flags & RESTARTING)
        for picture in pictures(container, stream, threads):
            frame = picture.frame
            first = first or frame
            if (frame.width, frame.height) != (first.width, first.height):
                raise SceneError(
                    path,
                    f"frames of one size, {first.width} x {first.height} pixels",
                    f"{frame.width} x {frame.height} pixels at frame {len(stamps)}",
                )
            stamp = frame.dts if unordered or frame.pts is None else frame.pts
            stamps.append(None if stamp is None else float(stamp * unit))
            intact.append(not picture.damaged)
            interlaced += frame.interlaced_frame
            lost += picture.lost
        if first is None:
            raise SceneError(path, "a video", "no frame that can be decoded")
        guessed = float(stream.guessed_rate or stream.average_rate or USUAL_RATE)
        times, continued = ascending(stamps, usual_step(stamps) or 1 / guessed, jumping)
        times -= times[0] if unordered else clock_start(container)
        stamped = any(stamp is not None for stamp in stamps)
        tick = float(unit)
        aspect = float(stream.sample_aspect_ratio or 1)
        if abs(aspect - 1) * max(first.width, first.height) <= ROUNDED_PIXELS:
            aspect = 1.0
        covers = sum(bool(other.disposition & NO_FILM) for other in container.streams.video)
        films = len(container.streams.video) - covers
    if min(first.width, first.height) < SIZE_LIMIT:
        raise SceneError(path, f"at least {SIZE_LIMIT} pixels a side", f"{first.width} x {first.height}")
    rate, even = rate_of(times, tick, guessed)
    return Film(
        path=path,
        stored=(first.width, first.height),
        turn=turn_of(first),
        pixel_aspect=aspect,
        bits=max(component.bits for component in first.format.components),
        transfer=int(first.color_trc),
        interlaced=interlaced,
        times=times,
        intact=np.array(intact),
        rate=rate,
        even=even,
        lost=lost,
        stamped=stamped,
        continued=continued,
        films=films,
        covers=covers,
        threads=threads,
    )


def turn_of(frame: av.VideoFrame) -> tuple[int, int, int, int]:
    """a, b, c, d of the display matrix, the nearest of the eight that keep pixels on the grid."""
    data: Any = frame.side_data.get("DISPLAYMATRIX")
    if data is None:
        return UNTURNED
    a, b, _, c, d = np.frombuffer(bytes(data), np.int32)[:5].tolist()
    if abs(a) + abs(d) >= abs(b) + abs(c):
        return int(math.copysign(1, a)), 0, 0, int(math.copysign(1, d))
    return 0, int(math.copysign(1, b)), int(math.copysign(1, c)), 0
