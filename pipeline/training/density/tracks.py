"""Tracks: paths in space and time along which brief Gaussians follow one another.

Where an object flies, training finds short rows of Gaussians, each alive for a few moments. A track is the mean of
those near it, moment after moment: mean shift (Comaniciu & Meer 2002) of position and velocity, predicted from the
moment before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

ATTEMPTS = 64  # seeds that are tried
MEAN_SHIFTS = 4  # steps at a moment
FEWEST_SEED, FEWEST_MEMBERS = 5, 20  # particles near a seed; members of a track
FEWEST_MOMENTS, MOST_MISSED = 6, 3  # moments of a track; successive ones without support within it
LEAST_SUPPORT = 0.1  # × the median support of the 8 moments before
MEMBER_DISTANCE, MEMBER_VELOCITY = 2.0, 3.0  # × the bandwidths


@dataclass(frozen=True)
class Particles:
    """Brief Gaussians on straight paths."""

    position: np.ndarray  # (n, 3) at its own time
    time: np.ndarray  # (n,)
    velocity: np.ndarray  # (n, 3)
    lifetime: np.ndarray  # (n,) standard deviation in time
    weight: np.ndarray  # (n,)


@dataclass(frozen=True)
class Bandwidths:
    """Standard deviations of the mean shift's kernel."""

    distance: float
    speed: float


@dataclass(frozen=True)
class Track:
    moments: np.ndarray  # (m,) indices of the times, ascending
    center: np.ndarray  # (m, 3)
    support: np.ndarray  # (m,) sum of the kernel's weights
    members: np.ndarray  # (k,) indices of the particles


def find_tracks(particles: Particles, times: np.ndarray, bandwidths: Bandwidths, most: int) -> list[Track]:
    """At most `most` tracks through ascending `times` (T,), with disjoint members; those of dense particles first."""
    spacing = float(np.diff(times).mean())
    reach = np.maximum(particles.lifetime, 0.75 * spacing)
    alive = [np.flatnonzero(np.abs(time - particles.time) < reach) for time in times]
    free = np.ones(len(particles.time), dtype=bool)  # of no track
    seeds = free.copy()
    features = np.c_[
        particles.position / bandwidths.distance, particles.velocity / bandwidths.speed, particles.time / (2 * spacing)
    ]
    found: list[Track] = []
    for _ in range(ATTEMPTS):
        candidates = np.flatnonzero(free & seeds)
        if len(found) == most or len(candidates) < FEWEST_MEMBERS:
            break
        tree = cKDTree(features[candidates])
        near = tree.query_ball_point(features[candidates], 1.0, return_length=True)
        if near.max() < FEWEST_SEED:
            break
        seed = int(candidates[near.argmax()])
        track = _followed(particles, free, alive, times, bandwidths, seed)
        if len(track.moments) < FEWEST_MOMENTS or len(track.members) < FEWEST_MEMBERS:
            seeds[track.members] = seeds[seed] = False
            continue
        free[track.members] = False
        found.append(track)
    return found


def _followed(
    particles: Particles,
    free: np.ndarray,
    alive: list[np.ndarray],
    times: np.ndarray,
    bandwidths: Bandwidths,
    seed: int,
) -> Track:
    """The track through the particle `seed`, forwards and backwards from its time."""

    def shifted(moment: int, center: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray, float] | None:
        """Mean shift among the particles alive at a moment: center, velocity, support; None without any."""
        rows = alive[moment][free[alive[moment]]]
        speed = particles.velocity[rows]
        place = particles.position[rows] + speed * (times[moment] - particles.time[rows])[:, None]
        support = 0.0
        for _ in range(MEAN_SHIFTS):
            apart = ((place - center) ** 2).sum(axis=1) / bandwidths.distance**2
            apart += ((speed - velocity) ** 2).sum(axis=1) / bandwidths.speed**2
            kernel = np.exp(-0.5 * apart) * particles.weight[rows]
            support = float(kernel.sum())
            if support < 1e-3:
                return None
            center, velocity = kernel @ place / support, kernel @ speed / support
        return center, velocity, support

    first = int(np.abs(times - particles.time[seed]).argmin())
    start = shifted(first, particles.position[seed], particles.velocity[seed])
    path = {} if start is None else {first: start}
    for step in (1, -1) if start is not None else ():
        assert start is not None
        (center, velocity, support), missed, last = start, 0, first
        recent = [support]
        for moment in range(first + step, len(times) if step > 0 else -1, step):
            predicted = center + velocity * (times[moment] - times[last])
            reached = shifted(moment, predicted, velocity)
            if reached is None or not _continues(reached, predicted, recent, bandwidths):
                missed += 1
                if missed > MOST_MISSED:
                    break
                continue
            path[moment], (center, velocity, support), missed, last = reached, reached, 0, moment
            recent.append(support)
    moments = np.array(sorted(path), dtype=int)
    if len(moments) == 0:
        return Track(moments, np.zeros((0, 3)), np.zeros(0), np.zeros(0, dtype=int))
    center, velocity = (np.array([path[moment][part] for moment in moments]) for part in (0, 1))
    at = [
        np.stack([np.interp(particles.time, times[moments], column) for column in of.T], 1) for of in (center, velocity)
    ]
    spacing = float(np.diff(times).mean())
    inside = (particles.time > times[moments[0]] - spacing) & (particles.time < times[moments[-1]] + spacing)
    inside &= np.linalg.norm(particles.position - at[0], axis=1) < MEMBER_DISTANCE * bandwidths.distance
    inside &= np.linalg.norm(particles.velocity - at[1], axis=1) < MEMBER_VELOCITY * bandwidths.speed
    return Track(moments, center, np.array([path[moment][2] for moment in moments]), np.flatnonzero(inside & free))


def _continues(
    reached: tuple[np.ndarray, np.ndarray, float], predicted: np.ndarray, recent: list[float], bandwidths: Bandwidths
) -> bool:
    """Whether what mean shift reached is dense enough, and near enough to the prediction, to be of the same track."""
    near = np.linalg.norm(reached[0] - predicted) <= MEMBER_DISTANCE * bandwidths.distance
    return bool(near and reached[2] >= LEAST_SUPPORT * np.median(recent[-8:]))
