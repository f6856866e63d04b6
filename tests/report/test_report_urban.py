"""The urban domain in a report: its table, its rule of held-out frames, and strips with depth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image
from report_runs import write_run

from pipeline.report.read import paper, scenes
from pipeline.report.tables.urban_table import urban
from pipeline.report.write.image_strips import make_strips
from pipeline.runs.read.collect import collect

DEPTHS = {"final.lidar_error_median": 0.031, "final.lidar_error_mean": 0.07, "final.lidar_rmse": 2.5}


def test_rows_name_the_clip_and_the_rule_of_held_out_frames(tmp_path: Path) -> None:
    write_run(tmp_path, "kitti/04", scene_settings="  test_every: 4\n", **DEPTHS)
    write_run(tmp_path, "kitti/04", ablation="static", scene_settings="  test_every: 4\n", psnr=23.0)
    write_run(tmp_path, "waymo/003", scene_settings="  test_every: 10\n  validation_every: 4\n")
    write_run(tmp_path, "synthetic/wheel")
    table = urban(collect(tmp_path))
    assert table is not None
    ours = [row.cells for row in table.rows if row.kind == "ours"]
    assert [(row["clip"].text, row["held_out"].text) for row in ours] == [
        ("kitti/04", "every 4th frame"),
        ("kitti/04", "every 4th frame"),
        ("waymo/003", "every 4th training frame (validation)"),
    ]
    by_method = {row["method"].text: row for row in ours if row["clip"].text == "kitti/04"}
    assert by_method["Ours, full, fast"]["lidar_error"].text == "0.0310"
    assert by_method["Ours, static, fast"]["lidar_error"].text == "n/a"
    others = [row.cells for row in table.rows if row.kind == "other"]
    assert len(others) == 2 * len(paper.read("urban")) and "28.11" in {row["psnr"].text for row in others}
    assert all("other clips" in note or "Depth" in note for _, note in table.notes[:2])


def test_there_is_no_table_without_driving_logs(tmp_path: Path) -> None:
    write_run(tmp_path, "synthetic/wheel")
    assert urban(collect(tmp_path)) is None
    assert scenes.family("kitti/04") == scenes.family("waymo/003") == "urban"


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
