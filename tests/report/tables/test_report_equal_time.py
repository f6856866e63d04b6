"""PSNR of schedules at equal training time, against interpolation by hand."""

from __future__ import annotations

import math

import pandas as pd
import pytest
from report_runs import write_run

from pipeline.report.tables.equal_time import equal_time, psnr_at
from pipeline.runs.read.collect import collect


def test_psnr_is_interpolated_and_nan_before_the_first_evaluation() -> None:
    curve = pd.DataFrame({"train_seconds": [10.0, 30.0, 20.0], "psnr": [20.0, 26.0, 24.0]})
    assert psnr_at(curve, 15.0) == 22.0
    assert psnr_at(curve, 30.0) == 26.0
    assert math.isnan(psnr_at(curve, 5.0))


def test_the_slower_schedule_is_read_where_the_faster_ended(tmp_path) -> None:
    for seed in range(2):  # seed s ends after 60 + s seconds, in both
        write_run(tmp_path, "synthetic/wheel", train="fast", seed=seed, psnr=25.0 + seed)
        slow = write_run(tmp_path, "synthetic/wheel", train="paper", seed=seed, psnr=27.0)
        curve = pd.read_csv(slow / "error_vs_time.csv")
        curve["train_seconds"] *= 4
        curve.to_csv(slow / "error_vs_time.csv", index=False)
    table = equal_time(collect(tmp_path))
    rows = {row.cells["train"].text: row.cells for row in table.rows}
    assert rows["fast"]["shared_seconds"].value == rows["paper"]["shared_seconds"].value == 60.0
    assert rows["paper"]["final_psnr"].value == 27.0
    # The slow curve's first evaluation, 27 - 8 + 2 = 21 dB, is at 60 and 61 s: so the second run has none at 60 s.
    assert rows["paper"]["shared_psnr"].text == "n/a"
    # `fast` ends at 25 and 26 dB. Its second run is read at 60 of 61 s, in the last quarter, which rises 8/3 - 8/4 dB.
    second = 26.0 - (8 / 3 - 8 / 4) * 1.0 / (61 / 4)
    assert rows["fast"]["shared_psnr"].value == pytest.approx((25.0 + second) / 2)


def test_no_table_for_one_schedule_per_scene(tmp_path) -> None:
    write_run(tmp_path, "synthetic/wheel", train="fast")
    write_run(tmp_path, "synthetic/lamp", train="paper")
    assert equal_time(collect(tmp_path)) is None
