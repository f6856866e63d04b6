"""A gain and an offset a channel for each camera, so that the colours of common points agree; robust least squares.

The residual of a match is its corrected colour less the mean of its point's corrected colours, which is linear in all
gains and offsets. Every correction at once could shrink the colours to nothing; so some cameras are given, or the mean
correction is the identity.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import least_squares

from datasets.cameras.color import ColorCorrection
from pipeline.data.colors.matches import Matches

LOSS_SCALE = 3.0  # of 255: residuals beyond it count less and less (soft L1)
MOST_ROWS = 20_000  # of the least squares; more matches would not make it better
CONTRAST = 64.0  # of 255: unit of the gains, so that gains and offsets change colours by as much


def fit(matches: Matches, given: Mapping[int, ColorCorrection]) -> dict[int, ColorCorrection]:
    """Camera -> its correction, of all cameras in `matches`; those of `given` are kept.

    matches: of points that two cameras see, or more. Without a given one the mean correction is the identity.
    """
    matches = _thinned(matches)
    cameras = np.unique(matches.camera)
    place = np.searchsorted(cameras, matches.camera)
    free = [i for i, camera in enumerate(cameras) if camera not in given]
    fixed = {i: given[camera] for i, camera in enumerate(cameras) if camera in given}
    basis = np.eye(len(free)) if fixed else null_space(np.ones((1, len(free))))
    gains, offsets = np.ones((len(cameras), 3)), np.zeros((len(cameras), 3))
    for i, correction in fixed.items():
        gains[i], offsets[i] = correction.gain, correction.offset
    for channel in range(3):
        values = matches.color[:, channel]
        middle = float(values.mean())
        start = _less_mean(matches.point, gains[place, channel] * values + offsets[place, channel])
        # Columns: what a gain, then an offset, of each free camera adds to each corrected colour.
        one = (place[:, None] == np.array(free)[None]).astype(float)
        slope = np.concatenate([one * ((values - middle) / CONTRAST)[:, None], one], axis=1)
        slope = _less_mean(matches.point, slope @ np.kron(np.eye(2), basis))
        found = _least_squares(slope, start)
        change = basis @ found.reshape(2, -1).T  # (free cameras, 2)
        gains[free, channel] += change[:, 0] / CONTRAST
        offsets[free, channel] += change[:, 1] - change[:, 0] / CONTRAST * middle
    return {int(c): ColorCorrection.from_arrays(gain, offset) for c, gain, offset in zip(cameras, gains, offsets)}


def around_most(corrections: Mapping[int, ColorCorrection], middle: np.ndarray) -> dict[int, ColorCorrection]:
    """The same relative corrections, with the cameras' median the identity: most cameras are hardly changed.

    middle: (3,) mean colour, of 255.
    """
    gains = np.array([c.gain for c in corrections.values()])
    at_middle = np.array([c.of(middle) for c in corrections.values()])
    scale = 1 / np.median(gains, axis=0)
    shift = middle - scale * np.median(at_middle, axis=0)
    return {
        camera: ColorCorrection.from_arrays(scale * c.gain, scale * c.offset + shift)
        for camera, c in corrections.items()
    }


def disagreement(matches: Matches, corrections: Mapping[int, ColorCorrection], camera: int, corrected: bool) -> float:
    """Median distance of a camera's colours from the mean of the other cameras' corrected ones, of 255.

    corrected: whether the camera's own colours are taken corrected.
    """
    colors = np.empty_like(matches.color)
    for other in np.unique(matches.camera):
        rows = matches.camera == other
        keep = other == camera and not corrected
        colors[rows] = matches.color[rows] if keep else corrections[int(other)].of(matches.color[rows])
    own = matches.camera == camera
    _, point = np.unique(matches.point, return_inverse=True)
    count = np.bincount(point) - np.bincount(point, own)
    total = np.stack([np.bincount(point, channel * ~own) for channel in colors.T], axis=1)
    rows = np.flatnonzero(own & (count[point] > 0))
    others = total[point[rows]] / count[point[rows], None]
    return float(np.median(np.abs(colors[rows] - others).mean(axis=1)))


def _thinned(matches: Matches) -> Matches:
    """Every so many-th point, so that at most about MOST_ROWS rows are left."""
    every = -(-len(matches.point) // MOST_ROWS)
    _, number = np.unique(matches.point, return_inverse=True)
    return matches if every == 1 else matches.where(number % every == 0)


def _least_squares(slope: np.ndarray, start: np.ndarray) -> np.ndarray:
    """(K,) x with the least soft L1 of start (M,) + slope (M, K) x."""
    guess = np.zeros(slope.shape[1])
    return least_squares(lambda x: start + slope @ x, guess, lambda x: slope, loss="soft_l1", f_scale=LOSS_SCALE).x


def _less_mean(point: np.ndarray, values: np.ndarray) -> np.ndarray:
    """values (M,) or (M, K) less the mean over the rows of the same point."""
    _, number, count = np.unique(point, return_inverse=True, return_counts=True)
    columns = values.reshape(len(values), -1)
    means = np.stack([np.bincount(number, column) / count for column in columns.T], axis=1)
    return (columns - means[number]).reshape(values.shape)
