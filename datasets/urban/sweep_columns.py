"""How many values a row of a LiDAR sweep has, which its file does not say: 3 (x, y, z) to 8.

Read with the right number, a column holds one quantity. With a wrong one it mixes several, and the entropy of a mixture
is never below the mean of its parts' entropies. The right number is therefore the one of the least mean entropy of
columns; multiples of it have the same, so that the least of equals is taken.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from datasets.files.errors import SceneError

TRIED = range(3, 9)
BINS = 32  # of all values alike, by their quantiles
FEWEST_VALUES = 800  # 100 rows of 8: entropies are then known to about 0.02
EQUAL, DIFFERENT = 0.1, 0.2  # nats; right and wrong numbers differ by 0.2 to 1, a number and its multiples by 0.01


def row_length(values: np.ndarray, usual: int, path: Path) -> int:
    """The number of values a row, of all values (n,) of a file: the layout's `usual` one unless the values refute it.

    SceneError where no number or several stand out. Of fewer than FEWEST_VALUES nothing is told: as usual.
    """
    if values.size < FEWEST_VALUES or not np.isfinite(values).all():
        return usual
    edges = np.unique(np.quantile(values, np.linspace(0, 1, BINS + 1)[1:-1]))
    binned = np.searchsorted(edges, values, side="right")
    entropy = {columns: _mean_entropy(binned, columns) for columns in TRIED}
    least = min(entropy.values())
    best = next(columns for columns in TRIED if entropy[columns] <= least + EQUAL)
    if max(entropy.values()) > least + DIFFERENT and (usual % best == 0 or entropy[usual] > least + DIFFERENT):
        return best
    found = ", ".join(f"{columns}: {value:.2f}" for columns, value in entropy.items())
    raise SceneError(
        path, f"columns of one quantity each, {usual} values a row", f"none that stand out (entropy by columns {found})"
    )


def _mean_entropy(binned: np.ndarray, columns: int) -> float:
    """Mean over the columns of the entropy of their values, nats, with Miller and Madow's correction."""
    found = []
    for column in range(columns):
        counts = np.bincount(binned[column::columns])
        share = counts[counts > 0] / counts.sum()
        found.append(-(share * np.log(share)).sum() + (len(share) - 1) / (2 * counts.sum()))
    return float(np.mean(found))
