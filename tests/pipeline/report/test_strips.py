"""Curves and strips of the dynamic region, and of depth, in a report: where a run has them, and only there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from PIL import Image
from report_runs import write_run

from pipeline.report.__main__ import main
from pipeline.report.runs import collect
from pipeline.report.strips import OUTLINE, choose_views, enlarged_box, make_strips, outlined


def write_mask(folder: Path, view: str, box: tuple[slice, slice]) -> None:
    mask = np.zeros((24, 24), bool)
    mask[box] = True
    Image.fromarray(mask).save(folder / "renders" / f"{view}_moving.png")


def test_curves_show_the_dynamic_region_where_measured(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "runs", "synthetic/wheel")
    write_run(tmp_path / "runs", "synthetic/lamp")
    rows = pd.read_csv(folder / "error_vs_time.csv")
    rows.assign(psnr_moving=rows["psnr"] - 9).to_csv(folder / "error_vs_time.csv", index=False)
    assert main([str(tmp_path / "runs")]) == 0
    shown = {path.name.split("__")[0]: "dynamic region" in path.read_text()
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
    assert choose_views(folder / "renders", psnr)[-1] == ("largest dynamic region", "test_r_1")
    strips, warnings = make_strips(collect(tmp_path).runs)
    assert warnings == []
    assert [(s.model, s.choice_text, s.view) for s in strips if s.choice == "largest dynamic region"] == [
        ("full", "largest dynamic region", "test_r_1"),
        ("no_4drot", "largest dynamic region", "test_r_1"),
    ]
    assert {len(s.parts) for s in strips} == {3, 4}


def test_a_damaged_mask_is_no_mask(tmp_path: Path) -> None:
    folder = write_run(tmp_path, "synthetic/wheel", images=2)
    (folder / "renders/test_r_0_moving.png").write_bytes(b"no image")
    assert "largest dynamic region" not in [choice for choice, _ in choose_views(folder / "renders", {})]


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


def test_strips_have_a_depth_where_the_run_has(tmp_path: Path) -> None:
    folder = write_run(tmp_path, "kitti/04", images=2)
    plain = make_strips(collect(tmp_path).runs)[0]
    assert {strip.parts for strip in plain} == {("render", "truth", "difference × 4")}
    for file in (folder / "renders").glob("*_render.png"):
        picture = np.zeros_like(np.asarray(Image.open(file)))
        Image.fromarray(picture).save(file.with_name(file.name.replace("_render", "_rendered_depth")))
    strips, warnings = make_strips(collect(tmp_path).runs)
    assert strips and not warnings
    assert all(strip.parts[-1] == "depth" for strip in strips)
