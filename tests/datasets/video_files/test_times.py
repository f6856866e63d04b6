"""Time stamps as files have them, and the times that follow by hand."""

from __future__ import annotations

import numpy as np
import pytest

from datasets.video_files.times import ascending, rate_of

STEP = 0.5


@pytest.mark.parametrize(
    ("stamps", "expected", "continued"),
    [
        ([0, 0.5, 1], [0, 0.5, 1], 0),
        ([3, 3.5, 0, 0.5, 1], [3, 3.5, 4, 4.5, 5], 1),  # joined
        ([0, 0.5, 0, 0.5, 0], [0, 0.5, 1, 1.5, 2], 2),
        ([0, 0.5, 1, 0.75, 2], [0, 0.5, 1, 1.5, 2], 1),  # one out of order
        ([0, 0.5, 0.5, 1.5], [0, 0.5, 1, 1.5], 1),  # one twice
        ([0, None, 1, None, None], [0, 0.5, 1, 1.5, 2], 0),
        ([None, None, None], [0, 0.5, 1], 0),
        ([0, 0.5, 30, 30.5], [0, 0.5, 30, 30.5], 0),  # a pause
    ],
)
def test_times_ascend(stamps: list[float | None], expected: list[float], continued: int) -> None:
    times, jumps = ascending(stamps, STEP, jumping=False)
    assert times.tolist() == expected and jumps == continued


def test_where_stamps_may_jump_a_long_gap_is_a_new_recording() -> None:
    times, jumps = ascending([0, 0.5, 30, 30.5], STEP, jumping=True)
    assert times.tolist() == [0, 0.5, 1, 1.5] and jumps == 1


@pytest.mark.parametrize("rate", [24.0, 25.0, 30.0, 30_000 / 1001, 60_000 / 1001, 119.88011988011988, 18.5])
@pytest.mark.parametrize("tick", [1e-3, 1 / 90_000])
def test_rates_are_found_through_rounding_and_gaps(rate: float, tick: float) -> None:
    numbers = np.delete(np.arange(600), [50, 51, 52, *range(200, 300)])
    found, even = rate_of(np.rint(numbers / rate / tick) * tick, tick, stated=12.0)
    assert even and found == pytest.approx(rate, rel=1e-9 if rate != 18.5 else 1e-4)
