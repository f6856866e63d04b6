"""Training time to a PSNR, on hand-made curves."""

from __future__ import annotations

import pandas as pd
import pytest

from pipeline.presentation.table_files import markdown
from pipeline.report.runs import Collection
from pipeline.report.time_to_psnr import TimeToPsnr, levels_of, seconds_to


def curve(points: list[tuple[float, float]], run: str = "a", recipe: str = "fast") -> pd.DataFrame:
    rows = [{"train_seconds": s, "iteration": i, "psnr": p, "n_gaussians": 1} for i, (s, p) in enumerate(points)]
    return pd.DataFrame(rows).assign(
        run=run, scene_label="synthetic/wheel", protocol="p", model="full", recipe_label=recipe, seed=0
    )


def collection(*curves: pd.DataFrame) -> Collection:
    return Collection(pd.DataFrame(), pd.concat(curves, ignore_index=True), {})


@pytest.mark.parametrize(
    "level, expected",
    [
        (10.0, 1.0),  # above it from the first evaluation on
        (21.0, 15.0),  # half-way between 20 dB at 10 s and 22 dB at 20 s
        (22.0, 20.0),
        (24.0, 35.0),  # after a decrease: 18 dB at 30 s, 30 dB at 40 s
        (30.5, None),
    ],
)
def test_time_at_which_a_curve_first_reaches_a_level(level: float, expected: float | None) -> None:
    found = seconds_to(curve([(1, 12), (10, 20), (20, 22), (30, 18), (40, 30)]), level)
    assert found == (None if expected is None else pytest.approx(expected))


def test_default_levels_follow_the_best_curve() -> None:
    assert levels_of(pd.concat([curve([(1, 25.9)]), curve([(1, 23.0)])])) == (21, 23, 24, 25)


def test_level_that_is_never_reached() -> None:
    table = TimeToPsnr((25.0,)).build(
        collection(
            curve([(0, 20), (10, 30)], "a"), curve([(0, 20), (30, 30)], "b"), curve([(0, 20), (10, 24)], "c", "slow")
        )
    )
    fast, slow = table.rows
    assert fast.cells["seconds"].value == pytest.approx(10.0) and fast.cells["seconds"].error == pytest.approx(
        12.706205 * 5
    )  # t(1) × √50 / √2
    assert fast.cells["reached"].text == "2 of 2"
    assert slow.cells["seconds"].text == "never reached" and slow.cells["reached"].text == "0 of 1"
    assert "never reached" in markdown(table)


def test_number_of_seeds_that_reached_the_level() -> None:
    table = TimeToPsnr((25.0,)).build(collection(curve([(0, 20), (10, 30)], "a"), curve([(0, 20), (30, 21)], "b")))
    assert table.rows[0].cells["reached"].text == "1 of 2" and table.rows[0].cells["seconds"].value == 5.0


def test_no_table_without_curves() -> None:
    assert TimeToPsnr().build(collection(curve([]).reindex(columns=curve([(0, 0)]).columns))) is None
