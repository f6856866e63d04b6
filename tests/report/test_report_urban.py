"""The urban domain in a report: its table, its rule of held-out frames, and strips with depth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from report_runs import write_run

from pipeline.report.read import paper, scenes
from pipeline.report.tables.urban_parts import urban_parts
from pipeline.report.tables.urban_table import urban
from pipeline.report.write.image_strips import make_strips
from pipeline.runs.read.collect import collect
from pipeline.runs.read.variants import name_variants

DEPTHS = {"final.lidar_error_median": 0.031, "final.lidar_error_mean": 0.07, "final.lidar_rmse": 2.5}


def test_rows_name_the_clip_and_the_rule_of_held_out_frames(tmp_path: Path) -> None:
    validation = "every 4th of the training frames (validation)"
    write_run(tmp_path, "kitti/04", test_split="every 4th frame", **DEPTHS)
    write_run(tmp_path, "kitti/04", ablation="static", test_split="every 4th frame", psnr=23.0)
    write_run(tmp_path, "waymo/003", test_split=validation)
    write_run(tmp_path, "synthetic/wheel")
    table = urban(collect(tmp_path))
    assert table is not None
    ours = [row.cells for row in table.rows if row.kind == "ours"]
    assert [(row["clip"].text, row["held_out"].text) for row in ours] == [
        ("kitti/04", "every 4th frame"),
        ("kitti/04", "every 4th frame"),
        ("waymo/003", validation),
    ]
    by_method = {row["method"].text: row for row in ours if row["clip"].text == "kitti/04"}
    assert by_method["Ours, full, fast"]["lidar_error"].text == "0.0310"
    assert by_method["Ours, static, fast"]["lidar_error"].text == "n/a"
    others = [row.cells for row in table.rows if row.kind == "other"]
    assert len(others) == 2 * len(paper.read("urban")) and "28.11" in {row["psnr"].text for row in others}
    assert all("other clips" in note or "Depth" in note for _, note in table.notes[:2])


def test_parts_are_differences_of_common_seeds_with_two_standard_errors(tmp_path: Path) -> None:
    def write(seeds: range, name: str, psnr: float, spread: float, error: float, **more: Any) -> None:
        for seed in seeds:
            quality = {"final.lidar_error_median": error, "test_split": "every 4th frame", "train_seconds": 60.0}
            out, ablation = f"{name}/{seed}", "no_4drot" if name == "no_4drot" else "full"
            write_run(tmp_path, "kitti/04", ablation, psnr=psnr + spread * seed, seed=seed, out=out, **quality, **more)

    write(range(3), "unchanged", 25.0, 1.0, 0.03)  # 25, 26, 27: mean 26, standard error 1 / √3
    write(range(3), "no_cube_map", 23.0, 0.0, 0.04, overrides=["scene.background_model=none"])
    write(range(1, 3), "no_4drot", 20.0, 1.0, 0.03)
    write(range(1, 3), "no_depth", 20.0, 1.0, 0.05, overrides=["train.depth.lidar=0"])  # 21, 22 of 26, 27
    (table,) = urban_parts(name_variants(collect(tmp_path)))
    rows = {row.cells["change"].text: row.cells for row in table.rows}
    assert rows["none"]["psnr"].text == "26.00 ± 1.15" and rows["none"]["lidar_error"].text == "3.00 ± 0.00"
    assert rows["scene.background_model=none"]["psnr"].text == "-3.00 ± 1.15"
    assert rows["scene.background_model=none"]["lidar_error"].text == "+1.00 ± 0.00"
    assert rows["depth.lidar=0"]["psnr"].text == "-5.00 ± 1.41" and rows["depth.lidar=0"]["seeds"].text == "2"
    assert rows["no_4drot"]["psnr"].text == "-5.00 ± 1.41"
    assert rows["no_4drot"]["flow_error"].text == "n/a"
    assert ("", "kitti/04: held out every 4th frame.") in table.notes


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
