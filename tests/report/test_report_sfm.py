"""The section on structure from motion: rows, pictures and damaged files."""

from __future__ import annotations

import io

import pytest
from PIL import Image
from report_runs import write_run, write_sfm

from pipeline.report.read import scenes
from pipeline.report.write.sfm_section import sfm_section
from pipeline.runs.read.collect import collect

SALMON, BEEF = scenes.TABLE3


def cells(table) -> list[dict]:
    return [{key: cell.text for key, cell in row.cells.items()} for row in table.rows]


def test_one_row_and_one_picture_per_scene(tmp_path) -> None:
    for seed in (0, 1, 2):
        write_sfm(write_run(tmp_path, SALMON, seed=seed), seconds=40.0 if seed == 0 else 0.1)
    write_sfm(write_run(tmp_path, BEEF), poses="refined")
    write_run(tmp_path, "synthetic/wheel")
    found, warnings = sfm_section(collect(tmp_path).runs)
    assert not warnings
    assert cells(found.table) == [
        {
            "scene": scene,
            "poses": poses,
            "cameras": "20",
            "registered": "19",
            "points": "12,345",
            "mean_error_px": "0.625",
            "mean_track_length": "3.50",
            "seconds": seconds,
            "runs": runs,
        }
        for scene, poses, seconds, runs in ((BEEF, "refined", "42.5", "1"), (SALMON, "known", "40.0", "3"))
    ]
    assert not any("seeds" in note for _, note in found.table.footnotes)  # not means over seeds
    assert [picture.filename for picture in found.pictures] == [
        "plenoptic_cut_roasted_beef__sfm.webp",
        "plenoptic_flame_salmon__sfm.webp",
    ]
    assert Image.open(io.BytesIO(found.pictures[0].webp)).size == (80, 60)


def test_different_results_of_a_scene_have_rows_of_their_own(tmp_path) -> None:
    write_sfm(write_run(tmp_path, SALMON, seed=0))
    write_sfm(write_run(tmp_path, SALMON, seed=1), points=999)
    found, _ = sfm_section(collect(tmp_path).runs)
    assert [row["points"] for row in cells(found.table)] == ["12,345", "999"]
    assert len({picture.filename for picture in found.pictures}) == 2


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"points": None}, "points: expected a finite number, found None"),
        ({"mean_error_px": float("nan")}, "mean_error_px: expected a finite number, found nan"),
        ({"poses": "guessed"}, "poses: expected known, refined, estimated, found 'guessed'"),
    ],
)
def test_damaged_sfm_json_gives_a_warning(tmp_path, changes: dict, message: str) -> None:
    write_sfm(write_run(tmp_path, SALMON), **changes)
    found, warnings = sfm_section(collect(tmp_path).runs)
    assert found is None
    assert warnings == [f"{SALMON}/full/fast/seed0: sfm.json: {message}"]


def test_missing_picture_gives_a_warning_and_keeps_the_row(tmp_path) -> None:
    write_sfm(write_run(tmp_path, SALMON), picture=False)
    found, warnings = sfm_section(collect(tmp_path).runs)
    assert len(found.table.rows) == 1 and not found.pictures
    assert len(warnings) == 1 and "no picture of points and cameras" in warnings[0]
