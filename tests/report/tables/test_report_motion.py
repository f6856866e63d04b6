"""Columns, curves and strips of motion in a report: where a run has them, and only there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from PIL import Image
from report_runs import write_run

from pipeline.report.__main__ import main
from pipeline.report.tables.run_tables import all_runs
from pipeline.report.tables.scene_tables import scene_table
from pipeline.report.write.image_strips import choose_views, make_strips
from pipeline.report.write.moving_picture import OUTLINE, enlarged_box, outlined
from pipeline.runs.read.collect import collect

MOVING = {"final.psnr_moving": 15.5, "final.psnr_still": 33.0, "final.flow_error": 0.8, "final.flow_error_px": 2.0}


def write_mask(folder: Path, view: str, box: tuple[slice, slice]) -> None:
    mask = np.zeros((24, 24), bool)
    mask[box] = True
    Image.fromarray(mask).save(folder / "renders" / f"{view}_moving.png")


def test_tables_have_columns_for_the_numbers_that_runs_have(tmp_path: Path) -> None:
    write_run(tmp_path, "synthetic/wheel", **MOVING)
    write_run(tmp_path, "synthetic/lamp")  # as an older version wrote it: without these keys
    runs = collect(tmp_path).runs
    for table in (scene_table(runs, "synthetic"), all_runs(runs)):
        columns = [column.key for column in table.columns if column.group == "motion"]
        assert columns == ["final_moving", "final_still", "flow_error", "flow_error_px"]
        cells = sorted(table.cell(row, column).text for row in table.rows for column in table.columns
                       if column.key == "final_moving")  # fmt: skip
        assert cells == ["15.50", "n/a"]


def test_runs_of_an_older_version_have_no_such_columns(tmp_path: Path) -> None:
    write_run(tmp_path / "runs", "synthetic/lamp", images=2)
    runs = collect(tmp_path / "runs").runs
    for table in (scene_table(runs, "synthetic"), all_runs(runs)):
        assert {column.group for column in table.columns} & {"motion"} == set()
    assert main([str(tmp_path / "runs")]) == 0
    text = (tmp_path / "report/report.md").read_text()
    assert "moving" not in text and "most motion" not in text


def test_curves_show_moving_pixels_where_measured(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "runs", "synthetic/wheel", **MOVING)
    write_run(tmp_path / "runs", "synthetic/lamp")
    rows = pd.read_csv(folder / "error_vs_time.csv")
    rows.assign(psnr_moving=rows["psnr"] - 9).to_csv(folder / "error_vs_time.csv", index=False)
    assert main([str(tmp_path / "runs")]) == 0
    shown = {path.name.split("__")[0]: "moving pixels" in path.read_text()
             for path in (tmp_path / "report/plots").glob("*.svg")}  # fmt: skip
    assert shown == {"synthetic_wheel": True, "synthetic_lamp": False}


def test_the_view_with_most_motion_has_a_strip(tmp_path: Path) -> None:
    folder = write_run(tmp_path, "synthetic/wheel", images=3)
    other = write_run(tmp_path, "synthetic/wheel", "no_4drot", psnr=20.0, images=3)
    for run in (folder, other):
        write_mask(run, "test_r_0", (slice(2, 4), slice(2, 4)))
        write_mask(run, "test_r_1", (slice(2, 9), slice(2, 9)))
        write_mask(run, "test_r_2", (slice(0, 0), slice(0, 0)))
    psnr = {"test_r_0": 30.0, "test_r_1": 20.0, "test_r_2": 25.0}
    assert choose_views(folder / "renders", psnr)[-1] == ("most motion", "test_r_1")
    strips, warnings = make_strips(collect(tmp_path).runs)
    assert warnings == []
    assert [(s.ablation, s.choice_text, s.view) for s in strips if s.choice == "most motion"] == [
        ("full", "most motion", "test_r_1"),
        ("no_4drot", "most motion", "test_r_1"),
    ]
    assert {len(s.parts) for s in strips} == {3, 4}


def test_a_damaged_mask_is_no_mask(tmp_path: Path) -> None:
    folder = write_run(tmp_path, "synthetic/wheel", images=2)
    (folder / "renders/test_r_0_moving.png").write_bytes(b"no image")
    assert "most motion" not in [choice for choice, _ in choose_views(folder / "renders", {})]


def test_the_largest_part_is_enlarged_in_the_proportions_of_the_image() -> None:
    mask = np.zeros((60, 90), bool)
    mask[5:8, 5:8] = True
    mask[30:50, 60:80] = True
    left, upper, right, lower = enlarged_box(mask)
    assert left <= 60 and right >= 80 and upper <= 30 and lower >= 50  # all of the larger part
    assert left >= 0 and right <= 90 and upper >= 0 and lower <= 60
    assert (right - left) / (lower - upper) == 1.5 and right - left < 60
    assert enlarged_box(np.zeros((60, 90), bool)) == (0, 0, 90, 60)
    assert enlarged_box(np.ones((60, 90), bool)) == (0, 0, 90, 60)


def test_the_outline_is_next_to_the_mask() -> None:
    mask = np.zeros((12, 12), bool)
    mask[4:8, 5:9] = True
    pixels = np.asarray(outlined(Image.new("RGB", (12, 12), (1, 2, 3)), mask))
    marked = (pixels == OUTLINE).all(axis=-1)
    expected = np.zeros((12, 12), bool)
    expected[3:9, 4:10] = True
    np.testing.assert_array_equal(marked, expected & ~mask)
