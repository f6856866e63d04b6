"""Numbers as a viewer stores them: each a whole number of steps, in as few bytes as its column needs.

A column of C components is stored component by component, each with its lowest byte first: all Gaussians' first bytes,
then all their second ones. Neighbours in space are neighbours in a column, so the higher bytes hardly change and the
compression that follows removes them.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np


@dataclass(frozen=True)
class Column:
    """How a column is stored. A stored number q of component c is the value (low[c] + q) · step."""

    name: str
    step: float
    low: tuple[int, ...]
    bytes: tuple[int, ...]  # of a number, by component; 0 where all are equal

    def to_dict(self) -> dict:
        return asdict(self)


def quantised(name: str, values: np.ndarray, step: float) -> tuple[Column, list[bytes]]:
    """(column, its planes of bytes) of `values` (N, …), of which a reader gets the nearest multiples of `step`."""
    rows = np.ascontiguousarray(values.reshape(len(values), math.prod(values.shape[1:])).T)
    counts = np.rint(rows / rows.dtype.type(step)).astype(np.int64 if rows.dtype == np.float64 else np.int32)
    low = counts.min(axis=1) if counts.size else np.zeros(len(counts), counts.dtype)
    above = (counts - low[:, None]).astype("<u4")
    sizes = tuple((int(largest).bit_length() + 7) // 8 for largest in above.max(axis=1, initial=0))
    digits = above.view(np.uint8).reshape(*above.shape, 4)
    planes = [digits[c, :, byte].tobytes() for c, size in enumerate(sizes) for byte in range(size)]
    return Column(name, step, tuple(low.tolist()), sizes), planes
