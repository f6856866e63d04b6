"""Which part of a clip is used, and which of its frames: the sharpest of every stretch of movement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from datasets.clip.survey import Survey

# Between frames of one take, what the flow leaves unexplained is 0.03 to 0.2 contrasts; across a cut 0.5 and more.
CUT_LEAST, CUT_FACTOR, CUT_NEIGHBOURS = 0.4, 3.0, 8
BLURRED = 0.5  # × the median sharpness of BLUR_NEIGHBOURS frames on either side
BLUR_NEIGHBOURS = 7
DUPLICATE_FLOW, DUPLICATE_CHANGE = 2e-4, 0.03  # image widths, contrasts: a frame that a varying rate has repeated
TIME_SHARE = 0.5  # of evenly spaced frames: half by time, half by movement


@dataclass(frozen=True)
class Choice:
    """The frames in use, and what was left out."""

    indices: tuple[int, ...]  # of the clip, ascending
    times: tuple[float, ...]  # seconds since the clip's start
    notes: tuple[str, ...]  # a line each, for the user


def choose(found: Survey, most: int, still: bool = False) -> Choice:
    """At most `most` frames of the longest part without a cut. The result may be empty.

    still: the camera stands still, so that frames that are alike are not repeated ones.
    """
    parts = _parts(found)
    notes = []
    damaged = int((~found.good).sum())
    if damaged:
        notes.append(f"{damaged} of {len(found.good)} frames are damaged and left out")
    if not parts:
        return Choice((), (), tuple(notes))
    rows = max(parts, key=len)
    dark = int((found.good & found.dark).sum())
    if dark:
        notes.append(f"{dark} frames show nothing (a fade, or a covered lens) and are left out")
    if len(parts) > 1:
        used, *others = (
            f"{found.time[p[0]]:.1f}–{found.time[p[-1]]:.1f} s" for p in sorted(parts, key=lambda p: p is not rows)
        )
        notes.append(
            f"the clip is cut: one scene is one take, so the longest part is used, {used} of it; left out: "
            f"{', '.join(others)}"
        )
    sharp = rows[~_blurred(found.sharpness[rows])]
    moved = sharp if still else sharp[~_repeated(found, sharp)]
    for what, count in (("blurred", len(rows) - len(sharp)), ("repeated", len(sharp) - len(moved))):
        if count:
            notes.append(f"{count} {what} frames are left out")
    chosen = moved if len(moved) <= most else _sharpest(found, moved, most)
    if len(chosen) < len(moved):
        notes.append(
            f"{len(chosen)} of {len(moved)} frames are used (scene.frames={most}): the sharpest, evenly spread"
        )
    return Choice(
        tuple(int(found.index[row]) for row in chosen), tuple(float(found.time[row]) for row in chosen), tuple(notes)
    )


def _parts(found: Survey) -> list[np.ndarray]:
    """Rows of the good frames between cuts and fades, in order."""
    usable = np.flatnonzero(found.good & ~found.dark)
    if len(usable) == 0:
        return []
    blurred = _blurred(found.sharpness[usable])  # a blurred frame continues neither neighbour, and is no cut
    cut = _cuts(found.unexplained[usable]) & ~blurred & ~np.roll(blurred, 1)
    # A fade: dark frames between two usable ones. A few damaged frames do not divide a take.
    dark = np.cumsum(found.good & found.dark)
    faded = np.diff(dark[usable], prepend=dark[usable[0]]) > 0
    return np.split(usable, np.flatnonzero((cut | faded)[1:]) + 1)


def _cuts(unexplained: np.ndarray) -> np.ndarray:
    """(N,) bool: frames that do not continue the frame before."""
    usual = np.array([
        np.median(np.delete(unexplained[max(0, i - CUT_NEIGHBOURS) : i + CUT_NEIGHBOURS + 1], min(i, CUT_NEIGHBOURS)))
        if len(unexplained) > 2 else unexplained[i]
        for i in range(len(unexplained))
    ])  # fmt: skip
    return unexplained > np.maximum(CUT_LEAST, CUT_FACTOR * usual)


def _blurred(sharpness: np.ndarray) -> np.ndarray:
    n = len(sharpness)
    usual = [np.median(sharpness[max(0, i - BLUR_NEIGHBOURS) : i + BLUR_NEIGHBOURS + 1]) for i in range(n)]
    return sharpness < BLURRED * np.array(usual)


def _repeated(found: Survey, rows: np.ndarray) -> np.ndarray:
    repeated = (found.flow[rows] < DUPLICATE_FLOW) & (found.unexplained[rows] < DUPLICATE_CHANGE)
    repeated[:1] = False
    return repeated


def _sharpest(found: Survey, rows: np.ndarray, most: int) -> np.ndarray:
    """The sharpest frame of each of `most` stretches, equal in a mean of time and movement."""
    moved = np.cumsum(found.flow[rows])
    along = [
        (x - x[0]) / (x[-1] - x[0]) if x[-1] > x[0] else np.linspace(0, 1, len(x)) for x in (found.time[rows], moved)
    ]
    position = TIME_SHARE * along[0] + (1 - TIME_SHARE) * along[1]
    stretch = np.minimum((position * most).astype(int), most - 1)
    best: dict[int, int] = {}
    for row, number in zip(rows, stretch):
        if number not in best or found.sharpness[row] > found.sharpness[best[number]]:
            best[number] = int(row)
    return np.array(sorted(best.values()))
