"""The section on structure from motion: rows, pictures and damaged files."""

from __future__ import annotations

import base64
import io
import re

import pytest
from PIL import Image
from report_runs import write_run, write_sfm

from pipeline.report import scenes
from pipeline.report.build import build_report
from pipeline.report.runs import collect
from pipeline.report.sfm import sfm_section

SALMON, BEEF = scenes.TABLE3


def cells(table) -> list[dict]:
    return [{key: cell.text for key, cell in row.cells.items()} for row in table.rows]


def test_one_row_and_one_picture_per_scene(tmp_path) -> None:
    for seed in (0, 1, 2):
        write_sfm(write_run(tmp_path, SALMON, seed=seed), seconds=40.0 if seed == 0 else 0.1)
    write_sfm(write_run(tmp_path, BEEF), poses="refined")
    write_run(tmp_path, "synthetic/wheel")
    table, pictures, warnings = sfm_section(collect(tmp_path).runs)
    assert not warnings
    assert cells(table) == [
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
    assert not any("seeds" in note for _, note in table.footnotes)  # not means over seeds
    assert [picture.filename for picture in pictures] == [
        "plenoptic_cut_roasted_beef__sfm.webp",
        "plenoptic_flame_salmon__sfm.webp",
    ]
    assert Image.open(io.BytesIO(pictures[0].webp)).size == (80, 60)


def test_different_results_of_a_scene_have_rows_of_their_own(tmp_path) -> None:
    write_sfm(write_run(tmp_path, SALMON, seed=0))
    write_sfm(write_run(tmp_path, SALMON, seed=1), points=999)
    table, pictures, _ = sfm_section(collect(tmp_path).runs)
    assert [row["points"] for row in cells(table)] == ["12,345", "999"]
    assert len({picture.filename for picture in pictures}) == 2


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
    table, pictures, warnings = sfm_section(collect(tmp_path).runs)
    assert table is None and not pictures
    assert warnings == [f"{SALMON}/full/fast/seed0: sfm.json: {message}"]


def test_missing_picture_gives_a_warning_and_keeps_the_row(tmp_path) -> None:
    write_sfm(write_run(tmp_path, SALMON), picture=False)
    table, pictures, warnings = sfm_section(collect(tmp_path).runs)
    assert len(table.rows) == 1 and not pictures
    assert len(warnings) == 1 and "no picture of points and cameras" in warnings[0]


def test_the_page_has_the_section_with_its_picture(tmp_path) -> None:
    write_sfm(write_run(tmp_path, SALMON))
    report = build_report([tmp_path])
    page, text = (report.files[name].decode() for name in ("report.html", "report.md"))
    assert 'id="sfm"' in page and "Points and camera poses from COLMAP" in report.terminal
    assert "![points and cameras of plenoptic/flame_salmon](strips/plenoptic_flame_salmon__sfm.webp)" in text
    (code,) = re.findall(r"data:image/webp;base64,([^\"]+)", page)
    assert Image.open(io.BytesIO(base64.b64decode(code))).size == (80, 60)
    without = build_report([tmp_path], ("plenoptic",)).files
    assert not any(name.startswith("strips/") for name in without) and "12,345" in without["report.html"].decode()
