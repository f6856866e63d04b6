"""One offset for each camera from the lags of all pairs, by least squares; the drift of clocks in long recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations

import numpy as np

from datasets.sync.correlate import Correlation, confidence, correlation
from datasets.sync.signals import Signal, picture_signals, sound_energy
from datasets.video_files.film import Film

APART = {"sound": 0.05, "picture": 0.2}  # seconds: a peak farther off is another lag
SURE = {"sound": 1.5, "picture": 0.8}  # confidence that a camera needs
# Confidence × seconds that it overlaps with the others on average. What repeats, a step or a swing, looks the same a
# period later, and a short overlap does not tell. Of 1760 random parts of films, 2 to 8 s long, wrong answers with
# SHORTEST_OVERLAP had up to 8.6 (sound) and 3.6 (picture).
SURE_SECONDS = {"sound": 10.0, "picture": 4.5}
SHORTEST_OVERLAP = 2.0  # seconds, on average
REACH = {"sound": 0.01, "picture": 0.03}  # seconds around the common solution in which a pair's own peak counts
ROUNDS = 10  # of moving one camera at a time
DRIFT_PART, DRIFT_LEAST = 20.0, 60.0  # seconds: of the two parts compared, of the recordings


@dataclass(frozen=True)
class Offsets:
    """When each camera started, on a common clock whose 0 is the first camera's start."""

    seconds: tuple[float, ...]
    drift: tuple[float, ...]  # relative: a clock that runs fast by 10 ppm has 1e-5
    method: str  # sound | picture | given
    confidence: tuple[float, ...]  # of each camera's place among the others, see correlate.confidence
    residual: float  # seconds: root mean square of what the pairs contradict each other by

    def lines(self, names: Sequence[str]) -> list[str]:
        """For the user."""
        by = {"sound": "the sound", "picture": "brightness and motion in the picture", "given": "scene.offsets"}
        starts = ", ".join(f"{name} {1e3 * s:+.1f} ms" for name, s in zip(names, self.seconds))
        found = [f"cameras started at {starts}, by {by[self.method]}"]
        if self.method != "given":
            found[0] += f"; pairs agree within {1e3 * self.residual:.1f} ms, confidence {min(self.confidence):.1f}"
        drifting = [f"{name} {1e6 * d:+.0f} ppm" for name, d in zip(names, self.drift) if d]
        return found + ([f"clocks drift: {', '.join(drifting)}"] if drifting else [])


def find_offsets(films: Sequence[Film], picture: bool = True) -> Offsets | None:
    """By sound where every camera has it and it decides, else by the picture; None where neither does.

    picture: whether it is asked. That of a camera that moves changes with the camera: of sets of signals that had
    nothing in common, one in twenty agreed well enough by chance.
    """
    return _found(tuple(films), picture)


@lru_cache(maxsize=4)  # a run asks twice: for its estimate, and to read the videos
def _found(films: tuple[Film, ...], picture: bool) -> Offsets | None:
    sounds = [sound_energy(film.path) for film in films]
    heard = [sound for sound in sounds if sound is not None]
    if len(heard) == len(films):
        found = offsets_of([[sound] for sound in heard], "sound")
        if found is not None:
            return with_drift(found, heard)
    if not picture:
        return None
    seen = [picture_signals(film) for film in films]
    return offsets_of(seen, "picture") if all(seen) else None


def offsets_of(signals: Sequence[Sequence[Signal]], method: str) -> Offsets | None:
    """The offsets with the largest sum of correlations over all pairs; None if a camera's place is not sure.

    A single pair may agree best at a wrong lag, where something repeats. So the surest pairs give a first solution, and
    each camera in turn is moved to where it agrees best with all others. The peaks of the pairs near that solution then
    give the offsets by least squares.
    """
    count, pairs = len(signals), {}
    for a, b in combinations(range(count), 2):
        found = correlation(signals[a], signals[b])
        if found is not None:
            pairs[a, b] = found
    placed = _first_solution(pairs, count, APART[method])
    if placed is None:
        return None
    sure = np.full(count, np.inf)
    for _ in range(ROUNDS):
        before = placed.copy()
        for camera in range(count):
            placed[camera], sure[camera] = _best_place(pairs, placed, camera, APART[method])
        if np.abs((placed - placed[0]) - (before - before[0])).max() < REACH[method]:
            break
    overlaps = _overlaps(signals, placed)
    if sure.min() < SURE[method] or overlaps.min() < SHORTEST_OVERLAP:
        return None
    if (sure * overlaps).min() < SURE_SECONDS[method]:
        return None
    used = []
    for (a, b), found in pairs.items():
        peak = found.peak_near(placed[b] - placed[a], REACH[method])
        if peak is not None:
            used.append((a, b, peak, max(float(found.at(np.array([peak]))[0]), 1e-3)))
    solved = _solve(used, count)
    if solved is None:
        return None
    residuals = np.array([solved[b] - solved[a] - seconds for a, b, seconds, _ in used])
    rms = float(np.sqrt(np.mean(residuals**2)))
    return Offsets(tuple(map(float, solved)), (0.0,) * count, method, tuple(map(float, sure)), rms)


def _first_solution(pairs: dict[tuple[int, int], Correlation], count: int, apart: float) -> np.ndarray | None:
    """(count,) offsets along the surest pairs that connect all cameras; None if none do."""
    lags = []
    for (a, b), found in pairs.items():
        best, sure = confidence(found.lags, found.values, apart)
        lags.append((sure, a, b, float(found.lags[best])))
    offsets, known = np.zeros(count), {0}
    while len(known) < count:
        joining = [lag for lag in lags if (lag[1] in known) != (lag[2] in known)]
        if not joining:
            return None
        _, a, b, seconds = max(joining)
        if a in known:
            offsets[b] = offsets[a] + seconds
        else:
            offsets[a] = offsets[b] - seconds
        known |= {a, b}
    return offsets


def _best_place(
    pairs: dict[tuple[int, int], Correlation], placed: np.ndarray, camera: int, apart: float
) -> tuple[float, float]:
    """(offset, confidence) of one camera, the others where they are: the largest sum of its pairs' correlations."""
    own = [(a, b, found) for (a, b), found in pairs.items() if camera in (a, b)]
    step = min(float(found.lags[1] - found.lags[0]) for _, _, found in own)
    ends = [placed[a] + found.lags[[0, -1]] if b == camera else placed[b] - found.lags[[0, -1]] for a, b, found in own]
    places = np.arange(min(map(np.min, ends)), max(map(np.max, ends)), step)
    total = np.zeros(len(places))
    for a, b, found in own:
        total += found.at(places - placed[a] if b == camera else placed[b] - places)
    best, sure = confidence(places, total, apart)
    return float(places[best]), sure


def _overlaps(signals: Sequence[Sequence[Signal]], placed: np.ndarray) -> np.ndarray:
    """(count,) seconds that each camera recorded at once with another one, the mean over the others."""
    starts = placed + np.array([own[0].start for own in signals])
    ends = placed + np.array([_end(own[0]) for own in signals])
    common = np.minimum.outer(ends, ends) - np.maximum.outer(starts, starts)
    np.fill_diagonal(common, 0.0)
    return np.maximum(common, 0.0).sum(axis=1) / (len(placed) - 1)


def _solve(pairs: Sequence[tuple[int, int, float, float]], count: int) -> np.ndarray | None:
    """(count,) offsets, the first 0, of pairs (a, b, offset of b - offset of a, weight); None if not connected."""
    rows = np.zeros((len(pairs), count))
    for row, (a, b, _, _) in enumerate(pairs):
        rows[row, a], rows[row, b] = -1, 1
    if len(pairs) < count - 1 or np.linalg.matrix_rank(rows) < count - 1:
        return None
    weights = np.sqrt([weight for *_, weight in pairs])
    values = np.array([seconds for _, _, seconds, _ in pairs])
    solved = np.linalg.lstsq(rows * weights[:, None], values * weights, rcond=None)[0]
    return solved - solved[0]


def with_drift(found: Offsets, sounds: Sequence[Signal]) -> Offsets:
    """The offsets with the drift of each clock against the first, where both recordings are long."""
    drifts = [0.0]
    first = sounds[0]
    for sound, offset in zip(sounds[1:], found.seconds[1:]):
        low = max(first.start, sound.start + offset)
        high = min(_end(first), _end(sound) + offset)
        if high - low < DRIFT_LEAST:
            drifts.append(0.0)
            continue
        lags, middles = [], []
        for start in (low, high - DRIFT_PART):
            parts = _part(first, start), _part(sound, start - offset)
            agreeing = correlation([parts[0]], [parts[1]])
            peak = None if agreeing is None else agreeing.peak_near(offset, APART["sound"])
            if peak is not None:
                lags.append(peak)
                middles.append(start - offset + 0.5 * DRIFT_PART)
        drifts.append((lags[1] - lags[0]) / (middles[1] - middles[0]) if len(lags) == 2 else 0.0)
        if drifts[-1]:
            moved = lags[0] - drifts[-1] * middles[0]
            seconds = list(found.seconds)
            seconds[len(drifts) - 1] = moved
            found = replace(found, seconds=tuple(seconds))
    return replace(found, drift=tuple(drifts))


def _end(signal: Signal) -> float:
    return signal.start + signal.step * len(signal.values)


def _part(signal: Signal, start: float) -> Signal:
    first = max(0, round((start - signal.start) / signal.step))
    count = round(DRIFT_PART / signal.step)
    return Signal(signal.start + first * signal.step, signal.step, signal.values[first : first + count])
