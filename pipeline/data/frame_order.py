"""Views that are frames of a film: which camera took one, in what order they come, and which follow each other.

A scene that was filmed has a frame rate (frames in a unit of its time) and views named <split>/<camera>_<frame>:
test/cam00_0012.
"""

from __future__ import annotations

from collections.abc import Sequence

from datasets.scene import View

# Times are frame numbers over the rate, rounded; a frame that is missing is a whole one.
SPACING_TOLERANCE = 0.1  # of a frame


def camera_name(view_name: str) -> str:
    """test/cam00_0012 -> cam00: the file's part before the last underscore; all of it where there is none."""
    stem = view_name.rsplit("/", 1)[-1]
    return stem.rpartition("_")[0] or stem


def film_order(views: Sequence[View], frame_rate: float | None) -> list[int]:
    """Indices of `views`, one camera after another, each in order of time; photographs (no rate) stay as they are."""
    indices = list(range(len(views)))
    if frame_rate is None:
        return indices
    return sorted(indices, key=lambda i: (camera_name(views[i].name), views[i].time))


def follows(before: View, after: View, frame_rate: float) -> bool:
    """Is `after` the next frame of the same camera?"""
    same_camera = camera_name(before.name) == camera_name(after.name)
    return same_camera and abs((after.time - before.time) * frame_rate - 1.0) < SPACING_TOLERANCE
