"""Which frames of clips are matched: within a camera by their distance, between cameras by their time."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, groupby

import numpy as np

from datasets.source import Photograph

# Frames matched with each frame, by their distance in time: near ones overlap most, far ones keep the path from
# drifting and find a place that is seen again.
DISTANCES = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256)
# Of two cameras: each frame with those of the other at the same time and so many frames off, when what moves is nearly
# the same, and some frames with some at any time, as one camera may see now what another saw before.
AROUND = (-8, -2, 0, 2, 8)
FEW = 3  # cameras: of more, frames at the same time and the spread ones are enough, as each is seen by many
SPREAD = 10


def by_lens(photographs: Sequence[Photograph]) -> list[list[Photograph]]:
    """The photographs of each camera; those of one follow one another."""
    return [list(group) for _, group in groupby(photographs, key=lambda photograph: photograph.lens)]


def pairs_of(lenses: Sequence[Sequence[Photograph]]) -> list[list[str]]:
    """Names of the photographs to match, in order of time for each camera."""
    pairs = []
    for lens in lenses:
        names = [photograph.name for photograph in lens]
        pairs += [[a, b] for d in DISTANCES for a, b in zip(names, names[d:])]
    for one, other in combinations(lenses, 2):
        around = AROUND if len(lenses) <= FEW else (0,)
        pairs += [[one[i].name, other[j].name] for i, j in sorted(_between(one, other, around))]
    return pairs


def _between(one: Sequence[Photograph], other: Sequence[Photograph], around: Sequence[int]) -> set[tuple[int, int]]:
    """Places of the photographs to match of two cameras. around: frames from the nearest in time."""
    times = np.array([[abs(a.time - b.time) for b in other] for a in one])
    nearest = [(i, int(j)) for i, j in enumerate(times.argmin(axis=1))]
    nearest += [(int(i), j) for j, i in enumerate(times.argmin(axis=0))]
    near = {(i, j + d) for i, j in nearest for d in around if 0 <= j + d < len(other)}
    ends = [np.unique(np.linspace(0, len(lens) - 1, SPREAD).round().astype(int)) for lens in (one, other)]
    return near | {(int(i), int(j)) for i in ends[0] for j in ends[1]}
