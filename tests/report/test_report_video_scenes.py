"""Multi-view video scenes in the report: the paper's Tables 1 and 3, flicker, structure from motion."""

from __future__ import annotations

import base64
import io
import re
import statistics

import pytest
from PIL import Image
from report_runs import write_run, write_sfm

from pipeline.report.__main__ import main
from pipeline.report.read import scenes
from pipeline.report.tables.paper_tables import ablation, plenoptic, plenoptic_per_scene
from pipeline.report.tables.run_tables import all_runs
from pipeline.report.tables.scene_tables import scene_table
from pipeline.runs.read.collect import collect
from pipeline.runs.read.variants import name_variants

SALMON, BEEF = scenes.TABLE3


def ours(table) -> list[dict]:
    return [{key: cell.text for key, cell in row.cells.items()} for row in table.rows if row.kind == "ours"]


# --- the paper's tables -----------------------------------------


def test_runs_of_all_six_scenes_fill_table_1(tmp_path) -> None:
    psnr = dict(zip(scenes.PLENOPTIC, (28.1, 32.2, 33.3, 29.4, 34.5, 33.6)))
    for scene in scenes.PLENOPTIC:
        for seed in (0, 1):
            write_run(
                tmp_path,
                scene,
                train="paper",
                seed=seed,
                psnr=psnr[scene] + seed,
                **{"final.lpips_alex": 0.05, "best_on_test.lpips_alex": 0.04},
            )
    runs = name_variants(collect(tmp_path)).runs
    mean = statistics.mean(psnr.values()) + 0.5  # 31.85 + 0.5 over two seeds, std of (0, 1): sqrt(1/2)
    final, best = ours(plenoptic(runs))
    assert final == {
        "method": "Ours, paper, final",
        "scenes": "6",
        "psnr": f"{mean:.2f} ± 0.71",
        "dssim": "0.020 ± 0.000",
        "dssim1": "0.050 ± 0.000",
        "dssim2": "0.040 ± 0.000",
        "lpips": "0.050 ± 0.000",
        "fps": "60.0 ± 0.0",
    }
    assert (best["method"], best["psnr"]) == ("Ours, paper, best on test", f"{mean + 0.25:.2f} ± 0.71")
    final, best = ours(plenoptic_per_scene(runs))
    assert [final[scenes.short(s)] for s in scenes.PLENOPTIC] == [
        f"{psnr[s] + 0.5:.2f} ± 0.71" for s in scenes.PLENOPTIC
    ]
    assert final["mean"] == f"{mean:.2f} ± 0.71"


def test_mean_of_fewer_scenes_states_their_number_and_is_not_in_the_table_per_scene(tmp_path) -> None:
    write_run(tmp_path, SALMON, train="paper", psnr=29.0)
    runs = name_variants(collect(tmp_path)).runs
    final = ours(plenoptic(runs))[0]
    assert (final["scenes"], final["psnr"], final["lpips"]) == ("mean of 1 of 6", "29.00", "n/a")
    assert ("", "LPIPS: no weights: offline") in plenoptic(runs).notes  # the reason for n/a
    final = ours(plenoptic_per_scene(runs))[0]
    assert final["flame_salmon"] == "29.00" and final["cook_spinach"] == "" and "mean" not in final


def test_runs_of_two_scenes_fill_table_3(tmp_path) -> None:
    for i, name in enumerate(scenes.ABLATIONS):
        for j, scene in enumerate(scenes.TABLE3):
            write_run(tmp_path, scene, name, train="paper", psnr=28.0 + i + 4 * j)
    rows = {(row["ablation"], row["method"]): row for row in ours(ablation(name_variants(collect(tmp_path)).runs))}
    assert len(rows) == 8
    for i, name in enumerate(scenes.ABLATIONS):
        row = rows[name, "Ours, paper, final"]
        assert (row["flame_salmon_psnr"], row["cut_roasted_beef_psnr"]) == (f"{28 + i}.00", f"{32 + i}.00")
        assert (row["mean_psnr"], row["flame_salmon_ssim"]) == (f"{30 + i}.00", "0.900")
        assert rows[name, "Ours, paper, best on test"]["mean_psnr"] == f"{30 + i}.25"


@pytest.mark.parametrize(
    "overrides, name",
    [
        (("scene.path=/elsewhere/salmon", "scene.cache=/tmp/x", "scene=plenoptic/flame_salmon"), "paper"),
        (("scene.frames=30", "train.batch=1"), "paper (scene.frames=30, batch=1)"),
        (
            ("scene.background_model=sphere", "init.source=random"),
            "paper (init.source=random, scene.background_model=sphere)",
        ),
    ],
)
def test_overrides_of_the_scene_are_in_the_name(tmp_path, overrides: tuple[str, ...], name: str) -> None:
    write_run(tmp_path, SALMON, train="paper", overrides=overrides)
    assert ours(plenoptic(name_variants(collect(tmp_path)).runs))[0]["method"] == f"Ours, {name}, final"


# --- flicker ----------------------------------------------------


def test_flicker_is_in_levels_of_255(tmp_path) -> None:
    for seed, flicker in enumerate((0.01, 0.03)):
        write_run(tmp_path, SALMON, seed=seed, **{"final.flicker": flicker})
    write_run(tmp_path, "synthetic/wheel")
    runs = collect(tmp_path).runs
    table = scene_table(runs, "plenoptic")
    assert "Flicker ↓ final, levels of 255" in [column.header for column in table.columns]
    assert ours(table)[0]["final_flicker"] == f"{255 * 0.02:.2f} ± {255 * 0.02 / 2**0.5:.2f}"
    assert not any("Flicker" in column.header for column in scene_table(runs, "synthetic").columns)
    assert [row["final_flicker"] for row in ours(all_runs(runs))] == ["2.55", "7.65", "n/a"]


def test_no_column_without_flicker(tmp_path) -> None:
    write_run(tmp_path, "synthetic/wheel", **{"final.flicker": None})
    runs = collect(tmp_path).runs
    for table in (scene_table(runs, "synthetic"), all_runs(runs)):
        assert not any("Flicker" in column.header for column in table.columns)
        assert not any("Flicker" in note for _, note in table.notes)


# --- the whole report --------------------------------------------------

SECTION = "Structure from motion"


def test_report_has_a_section_on_sfm(tmp_path, capsys) -> None:
    write_sfm(write_run(tmp_path / "runs", SALMON))
    assert main([str(tmp_path / "runs")]) == 0
    out, page, markdown = (
        capsys.readouterr().out,
        *((tmp_path / "report" / name).read_text() for name in ("report.html", "report.md")),
    )
    assert all(SECTION in text for text in (page, markdown))
    assert "Points and camera poses from COLMAP" in out
    assert "![points and cameras of plenoptic/flame_salmon](strips/plenoptic_flame_salmon__sfm.webp)" in markdown
    pictures = [
        Image.open(io.BytesIO(base64.b64decode(code))) for code in re.findall(r"data:image/webp;base64,([^\"]+)", page)
    ]
    assert [picture.size for picture in pictures] == [(80, 60)]
    anchors = set(re.findall(r'href="#([^"]+)"', page))
    assert "sfm" in anchors and anchors <= set(re.findall(r'id="([^"]+)"', page))
    assert {path.suffix for path in (tmp_path / "report/tables").glob("structure.*")} == {".md", ".csv"}


def test_no_pictures_also_excludes_sfm_pictures(tmp_path) -> None:
    write_sfm(write_run(tmp_path / "runs", SALMON))
    assert main([str(tmp_path / "runs"), "--no-pictures", "plenoptic"]) == 0
    assert not (tmp_path / "report/strips").exists()
    page = (tmp_path / "report/report.html").read_text()
    assert "12,345" in page and "data:image/webp" not in page


def test_empty_sections_are_left_out(tmp_path, capsys) -> None:
    write_run(tmp_path / "runs", "synthetic/wheel")
    main([str(tmp_path / "runs")])
    for text in (
        capsys.readouterr().out,
        *((tmp_path / "report" / name).read_text() for name in ("report.html", "report.md")),
    ):
        assert not any(section in text for section in (SECTION, "licker", "COLMAP"))
