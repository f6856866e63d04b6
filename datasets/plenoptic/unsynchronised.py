"""When cameras that were not synchronised started, and whether they are synchronised after all."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from datasets.files.errors import SceneError
from datasets.plenoptic.align import padded
from datasets.plenoptic.sync import RATE_TOLERANCE
from datasets.plenoptic.videos import Video
from datasets.source import Log
from datasets.sync.offsets import Offsets, find_offsets
from datasets.video_files.film import Film

SAME_START = 0.5  # frames: cameras that start nearer to each other than this, at one rate, are synchronised


def offsets_of(
    root: Path, videos: Sequence[Video], sync: str, given: Sequence[float], log: Log, moving: bool = False
) -> Offsets | None:
    """Starts of the cameras, given (sync=given) or found, with a line of what was found; None: taken as synchronised.

    moving: a camera moves, so that only the sound is asked. SceneError where neither sound nor picture decides and the
    videos differ in size, rate or length, or a camera moves.
    """
    if sync == "given":
        if len(given) != len(videos):
            raise SceneError(
                f"{root}: scene.offsets",
                f"{len(videos)} numbers, the seconds at which {', '.join(video.name for video in videos)} started",
                f"{len(given)}",
            )
        seconds = tuple(float(s) - float(given[0]) for s in given)
        found = Offsets(seconds, (0.0,) * len(videos), "given", (float("inf"),) * len(videos), 0.0)
    else:
        searched = find_offsets([video.film for video in videos], picture=not moving)
        if searched is None:
            films = [video.film for video in videos]
            equal = all(padded(f.size, films[0].size) and same_rate(f, films[0]) for f in films)
            lengths = {round(float(f.times[-1] - f.times[0]) * f.rate) for f in films}
            if moving or not equal or len(lengths) > 1:
                clue = "sound that all cameras hear" if moving else "sound, or motion that all cameras see"
                none = ", scene.sync=none takes them as synchronised" if moving or equal else ""
                raise SceneError(
                    root,
                    f"{clue}, to find out when each camera started",
                    f"{'it does not decide' if moving else 'neither decides'}; scene.sync=given scene.offsets=[0,…] "
                    f"states the seconds at which each started (0 for all: at once){none}; film 6 seconds and more, a "
                    "clap makes it certain",
                )
            log(
                "neither sound nor picture says when each camera started; of one size, rate and length they are taken "
                "as synchronised (scene.sync=given scene.offsets=[0,…] if they are not)"
            )
            return None
        found = searched
    for line in found.lines([video.name for video in videos]):
        log(line)
    return found


def same_rate(film: Film, other: Film) -> bool:
    return abs(film.rate - other.rate) <= RATE_TOLERANCE * other.rate


def is_synchronised(videos: Sequence[Video], offsets: Offsets) -> bool:
    """Whether the cameras have one size and rate, and frames within half a frame of each other's, without drift."""
    first = videos[0].film
    starts = np.array(offsets.seconds)
    if (
        not all(padded(v.film.size, first.size) and same_rate(v.film, first) for v in videos)
        or float(np.ptp(starts * first.rate)) >= SAME_START
        or any(offsets.drift)
    ):
        return False
    shortest = min(v.film.count for v in videos)
    times = np.stack([start + video.film.times[:shortest] for video, start in zip(videos, starts)])
    return float(np.ptp(times, axis=0).max()) < SAME_START / first.rate
