"""Times of frames as a player keeps them: ascending, also where recordings were joined; and their rate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

USUAL_RATE = 30.0  # frames a second, where a file does not say
USUAL_RATES = np.concatenate([np.arange(1.0, 241.0), np.arange(1.0, 241.0) * 1000 / 1001])
LONGEST_GAP = 10.0  # seconds, where stamps may jump: more is a new recording and no pause, as for the ffmpeg program


def ascending(stamps: Sequence[float | None], step: float, jumping: bool) -> tuple[np.ndarray, int]:
    """((frames,) seconds, how many times they were continued): `stamps`, but where they do not ascend.

    None continues by `step`, the usual one. After a jump back all later stamps are moved so that the frame follows by a
    step; a single frame out of order is put between its neighbours. jumping: the format's stamps may also jump ahead.
    """
    times = np.array([np.nan if stamp is None else stamp for stamp in stamps])
    for i in np.flatnonzero(np.isnan(times)).tolist():
        times[i] = times[i - 1] + step if i else 0.0
    continued = 0
    for i in range(1, len(times)):
        before = times[i - 1]
        if before < times[i] and not (jumping and times[i] - before > LONGEST_GAP):
            continue
        continued += 1
        if i + 1 < len(times) and before < times[i + 1] <= before + 3 * step:  # this one alone
            times[i] = 0.5 * (before + times[i + 1])
        else:
            times[i:] += before + step - times[i]
    return times, continued


def usual_step(stamps: Sequence[float | None]) -> float | None:
    """Seconds: the median of those that ascend; None without two."""
    steps = np.diff(np.array([stamp for stamp in stamps if stamp is not None]))
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else None


def rate_of(times: np.ndarray, tick: float, stated: float) -> tuple[float, bool]:
    """(frames a second of ascending `times`, whether these are at equal steps or several, rounded to a `tick`).

    Dropped frames do not lower it. The stated rate or a usual one where all times fit one; the mean of frames at no
    equal steps.
    """
    if len(times) < 2:
        return USUAL_RATE, True
    steps, passed = np.diff(times), times - times[0]
    single = steps[np.rint(steps / np.median(steps)) == 1]
    number = np.concatenate([[0.0], np.cumsum(np.rint(steps / single.mean()))])
    fitted = number[-1] / passed[-1]

    def fits(rate: float) -> bool:
        return bool(np.abs(passed - number / rate).max() <= 1.01 * tick)

    near = USUAL_RATES[np.abs(USUAL_RATES / fitted - 1) < 1e-2]
    for rate in (stated, *near[np.argsort(np.abs(near - fitted))]):
        if fits(rate):
            return float(rate), True
    if fits(fitted):
        return float(fitted), True
    return (len(times) - 1) / float(passed[-1]), False
