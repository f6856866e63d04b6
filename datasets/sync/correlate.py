"""How well two cameras' signals agree at each lag, by normalised cross-correlation, and how sure the best lag is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import fftconvolve

from datasets.sync.signals import Signal

LEAST_OVERLAP = 0.25  # of the shorter signal
LEAST_SECONDS = 1.0  # of overlap


@dataclass(frozen=True)
class Correlation:
    """Of two cameras' signals, by the lag of the other: other's clock + lag = the first one's clock."""

    lags: np.ndarray  # (N,) seconds, evenly spaced
    values: np.ndarray  # (N,) -1 to 1

    def at(self, lags: np.ndarray) -> np.ndarray:
        """Values between the grid's; 0 where the recordings do not overlap enough."""
        return np.interp(lags, self.lags, self.values, left=0.0, right=0.0)

    def peak_near(self, lag: float, reach: float) -> float | None:
        """The lag of the largest value within `reach`, between the grid's; None outside of the grid."""
        inside = np.flatnonzero(np.abs(self.lags - lag) <= reach)
        if len(inside) == 0:
            return None
        best = int(inside[np.argmax(self.values[inside])])
        return float(self.lags[best] + _parabola(self.values, best) * (self.lags[1] - self.lags[0]))


def correlation(signals: Sequence[Signal], others: Sequence[Signal]) -> Correlation | None:
    """The mean correlation of several signals of two cameras; None without enough overlap."""
    total, lags = None, None
    for signal, other in zip(signals, others, strict=True):
        values, lags = _correlations(signal.values, other.values, signal.step)
        if values is None:
            return None
        total = values if total is None else total + values
    if total is None or lags is None or len(lags) < 3:
        return None
    shift = signals[0].start - others[0].start
    return Correlation(shift + lags * signals[0].step, total / len(signals))


def confidence(lags: np.ndarray, values: np.ndarray, apart: float) -> tuple[int, float]:
    """(index of the largest value, how much it exceeds the best one farther than `apart` seconds from it).

    The latter is in standard deviations of all values.
    """
    best = int(np.argmax(values))
    away = values[np.abs(lags - lags[best]) > apart]
    second = float(away.max()) if len(away) else 0.0
    return best, (float(values[best]) - second) / max(float(values.std()), 1e-9)


def _correlations(a: np.ndarray, b: np.ndarray, step: float) -> tuple[np.ndarray | None, np.ndarray]:
    """(Pearson's correlation of the overlap × √(its share of the shorter), lag in steps): b[i] beside a[i + lag]."""
    least = max(int(LEAST_OVERLAP * min(len(a), len(b))), int(LEAST_SECONDS / step), 2)
    lags = np.arange(-(len(b) - 1), len(a))
    count = np.minimum(len(a), lags + len(b)) - np.maximum(0, lags)
    valid = count >= least
    if not valid.any():
        return None, lags

    def sliding(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return fftconvolve(x, y[::-1], mode="full")

    ones_a, ones_b = np.ones_like(a), np.ones_like(b)
    sum_a, sum_b = sliding(a, ones_b), sliding(ones_a, b)
    covariance = sliding(a, b) - sum_a * sum_b / np.maximum(count, 1)
    of_a = sliding(a**2, ones_b) - sum_a**2 / np.maximum(count, 1)
    of_b = sliding(ones_a, b**2) - sum_b**2 / np.maximum(count, 1)
    scale = np.sqrt(np.maximum(of_a, 1e-9 * count) * np.maximum(of_b, 1e-9 * count))
    # A short overlap agrees by chance: the correlation's standard deviation is 1 / √overlap.
    certainty = np.sqrt(count / min(len(a), len(b)))
    return (certainty * covariance / np.maximum(scale, 1e-9))[valid], lags[valid]


def _parabola(values: np.ndarray, best: int) -> float:
    """The peak's place relative to `best`, between the samples."""
    if not 0 < best < len(values) - 1:
        return 0.0
    left, middle, right = values[best - 1 : best + 2]
    bend = left - 2 * middle + right
    return float(0.5 * (left - right) / bend) if bend < 0 else 0.0
