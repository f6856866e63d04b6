"""Order of views that are video frames: their camera, their order in time, and which frames are consecutive.

Scenes of videos have a frame rate and views named <split>/<camera>_<frame>, e.g. test/cam00_0012.
"""

from __future__ import annotations

from collections.abc import Sequence

from datasets.scene import View

SPACING_TOLERANCE = 0.1  # frames; covers the rounding of times


def camera_name(view_name: str) -> str:
    """test/cam00_0012 -> cam00: the part of the file name before the last underscore, or the whole file name."""
    stem = view_name.rsplit("/", 1)[-1]
    return stem.rpartition("_")[0] or stem


def film_order(views: Sequence[View], frame_rate: float | None) -> list[int]:
    """Indices of `views` sorted by camera, then by time; the original order for photographs (no frame rate)."""
    indices = list(range(len(views)))
    if frame_rate is None:
        return indices
    return sorted(indices, key=lambda i: (camera_name(views[i].name), views[i].time))


def is_next_frame(before: View, after: View, frame_rate: float) -> bool:
    """Whether `after` is the frame after `before` of the same camera."""
    same_camera = camera_name(before.name) == camera_name(after.name)
    return same_camera and abs((after.time - before.time) * frame_rate - 1.0) < SPACING_TOLERANCE
