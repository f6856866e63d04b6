"""Statistics, the paper's numbers and the tables of the report, against hand computation; table file formats."""

from __future__ import annotations

import csv
import math
import statistics
from decimal import ROUND_HALF_UP, Decimal
from pathlib import Path

import numpy as np
import pytest
from report_runs import write_run

from pipeline.presentation.seed_statistics import compare, estimate, over_scenes
from pipeline.presentation.table import Cell, Column, Row, Table
from pipeline.presentation.table_files import comma_separated, escape, latex, markdown
from pipeline.report.__main__ import main
from pipeline.report.compare.curve_statistics import mean_and_std
from pipeline.report.read import paper, scenes
from pipeline.report.tables.ablation_verdicts import ablation_verdicts
from pipeline.report.tables.paper_tables import dnerf, paper_tables
from pipeline.runs.read.collect import collect


def read_csv(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def half_up(value: float, places: str = "0.01") -> float:
    """Rounds half up in decimal: 32.005 -> 32.01 (binary floats and banker's rounding give 32.00)."""
    return float(Decimal(repr(round(value, 9))).quantize(Decimal(places), ROUND_HALF_UP))


# --- statistics -------------------------------------------------


def test_mean_std_and_standard_error_by_hand():
    found = estimate([24.0, 25.0, 27.0])
    assert found.mean == pytest.approx(76 / 3)
    assert found.std == pytest.approx(statistics.stdev([24.0, 25.0, 27.0]))
    assert found.standard_error == pytest.approx(math.sqrt(7 / 3) / math.sqrt(3))  # variance by hand: 7/3
    assert math.isnan(estimate([24.0]).std)
    assert estimate([24.0, math.nan]) is None  # no mean over some of the seeds


def test_verdict_follows_the_two_standard_error_rule():
    full = estimate([26.0, 26.2, 26.4])  # std 0.2
    # SE of the difference = sqrt(0.04 / 3 + 0.04 / 3) = 0.16330, so the threshold is 0.32660 dB
    assert compare(full, estimate([25.67, 25.87, 26.07])).word == "worse"
    assert compare(full, estimate([25.68, 25.88, 26.08])).word == "no difference shown"
    assert compare(full, estimate([26.33, 26.53, 26.73])).word == "better"
    assert compare(full, estimate([20.0, 20.1])).word == "too few seeds"
    found = compare(full, estimate([25.0, 25.2, 25.4]))
    assert found.difference == pytest.approx(1.0)
    assert found.standard_error == pytest.approx(math.sqrt(0.04 / 3 + 0.04 / 3))


def test_mean_over_scenes_is_a_mean_of_scene_means(tmp_path):
    for seed, lego, hook in ((0, 25.0, 30.0), (1, 26.0, 32.0)):
        write_run(tmp_path, "dnerf/lego", seed=seed, psnr=lego)
        write_run(tmp_path, "dnerf/hook", seed=seed, psnr=hook)
    write_run(tmp_path, "dnerf/hook", seed=2, psnr=34.0)  # a third seed must not change the scene's weight
    found, count = over_scenes(collect(tmp_path).runs, scenes.DNERF, "full", "fast", "final.psnr")
    assert count == 2
    assert found.mean == pytest.approx((25.5 + 32.0) / 2)
    assert found.std == pytest.approx(statistics.stdev([27.5, 29.0]))  # seeds 0 and 1, which both scenes have


def test_mean_and_std_over_seeds_along_a_curve(tmp_path):
    write_run(tmp_path, "synthetic/wheel", seed=0)
    write_run(tmp_path, "synthetic/wheel", seed=1, psnr=26.0)
    x, mean, std = mean_and_std(collect(tmp_path).curves, "iteration", "psnr")
    # both curves have the same iterations and lie 1 dB apart everywhere: the std of (a, a + 1) is sqrt(1/2)
    assert (x[0], x[-1]) == (250, 1000)
    np.testing.assert_allclose(std, math.sqrt(0.5))
    assert mean[-1] == pytest.approx(25.5)


# --- the paper's numbers ----------------------------------------


def test_paper_scene_numbers_average_to_the_printed_means():
    for row in paper.read("table1_per_scene"):
        values = [float(row[scenes.short(s)]) for s in scenes.PLENOPTIC if row[scenes.short(s)]]
        # Printed to 0.01, so within 0.005; HexPlane's 31.706 is printed 31.70 (footnote ³): 0.0061.
        assert abs(statistics.mean(values) - float(row["printed_mean"])) < (0.0061 if row["note"] == "³" else 0.00501)


def test_paper_table_1_and_its_scene_table_agree():
    per_scene = {row["method"]: row["printed_mean"] for row in paper.read("table1_per_scene")}
    table = {row["method"].removesuffix("-L"): row["psnr"] for row in paper.read("table1_plenoptic")}
    assert all(table[method] == mean for method, mean in per_scene.items())
    assert table["4DGS (this paper)"] == "32.01"


def test_misprint_of_the_paper_is_corrected_with_a_footnote():
    row = next(r for r in paper.read("table3_ablation") if r["ablation"] == "no_time_split")
    mean = (float(row["flame_salmon_psnr"]) + float(row["cut_roasted_beef_psnr"])) / 2
    assert half_up(mean) == float(row["corrected_mean_psnr"]) == 30.88
    assert row["printed_mean_psnr"] == "30.25"
    assert "30.25" in dict(paper.footnotes("⁶"))["⁶"]


def test_paper_table_2():
    rows = {r["method"]: (r["psnr"], r["ssim"], r["lpips"]) for r in paper.read("table2_dnerf")}
    assert rows == {
        "T-NeRF": ("29.51", "0.95", "0.08"),
        "D-NeRF": ("29.67", "0.95", "0.07"),
        "TiNeuVox": ("32.67", "0.97", "0.04"),
        "HexPlanes": ("31.04", "0.97", "0.04"),
        "K-Planes-explicit": ("31.05", "0.97", ""),
        "K-Planes-hybrid": ("31.61", "0.97", ""),
        "V4D": ("33.72", "0.98", "0.02"),
        "4DGS (Wu)": ("33.30", "0.98", "0.03"),
        "4DGS (this paper)": ("34.09", "0.98", "0.02"),
    }


# --- tables -----------------------------------------------------


def test_paper_tables_without_our_runs_are_left_out(tmp_path):
    write_run(tmp_path, "synthetic/still")
    write_run(tmp_path, "dnerf/mine")
    assert paper_tables(collect(tmp_path)) == []
    write_run(tmp_path, "dnerf/lego")
    assert [table.slug for table in paper_tables(collect(tmp_path))] == ["table2_dnerf"]


def test_scene_without_our_runs_is_hidden_in_markdown_but_not_in_csv(tmp_path):
    write_run(tmp_path, "plenoptic/flame_steak", psnr=33.0)
    table = next(t for t in paper_tables(collect(tmp_path)) if t.slug == "table1_per_scene")
    shown = [line for line in markdown(table).splitlines() if line.startswith("|")]
    assert shown[0].split() == ["|", "Method", "|", "flame_steak", "|"]
    assert any("4DGS (this paper)" in line and "34.03" in line for line in shown)
    assert any("Ours, fast, final" in line and "33.00" in line for line in shown)
    assert comma_separated(table).splitlines()[0].startswith("kind,method,coffee_martini,cook_spinach,")


def test_table_2_states_the_number_of_scenes_of_a_mean(tmp_path):
    write_run(tmp_path, "dnerf/lego", psnr=26.5)
    table = dnerf(collect(tmp_path).runs)
    final, best = [row.cells for row in table.rows if row.kind == "ours"]
    assert final["scenes"].text == "mean of 1 of 8"
    assert (final["psnr"].text, best["psnr"].text) == ("26.50", "26.75")  # final above best on test, one seed: no ±
    assert final["lpips"].text == "n/a"  # the run lacks LPIPS


def test_verdicts_of_ablations(tmp_path):
    for seed in range(3):
        write_run(tmp_path, "synthetic/wheel", "full", seed=seed, psnr=30 + 0.1 * seed)
        write_run(tmp_path, "synthetic/wheel", "no_4drot", seed=seed, psnr=25 + 0.1 * seed)
        write_run(tmp_path, "synthetic/lamp", "full", seed=seed, psnr=30 + 0.1 * seed)
        write_run(tmp_path, "synthetic/lamp", "no_4dsh", seed=seed, psnr=30 + 0.1 * seed)
    words = [row.cells["verdict"].text for row in ablation_verdicts(collect(tmp_path).runs).rows]
    assert words == ["worse"] * 2 + ["no difference shown"] * 2


def test_ablation_without_runs_has_no_row_and_without_full_no_verdict(tmp_path):
    write_run(tmp_path, "synthetic/wheel", "full")
    assert ablation_verdicts(collect(tmp_path).runs) is None
    write_run(tmp_path, "synthetic/lamp", "no_4dsh")
    table = ablation_verdicts(collect(tmp_path).runs)
    assert [row.cells["verdict"].text for row in table.rows] == ["no run of full"] * 2
    assert not any("wheel" in note for _, note in table.footnotes)


def test_latex_escapes_every_special_character():
    assert escape(r"a_b & 50% {$#~^\ ± ×") == (
        r"a\_b \& 50\% \{\$\#\textasciitilde{}\textasciicircum{}\textbackslash{} $\pm$ $\times$"
    )
    table = Table(
        "t",
        "no_4drot & more",
        (Column("a", "A_1", False), Column("b", "B")),
        (Row({"a": Cell("x_y"), "b": Cell("1.00 ± 0.10", 1.0, 0.1)}, mark="¹"),),
    )
    source = latex(table)
    assert r"x\_y$^{1}$ & 1.00 $\pm$ 0.10 \\" in source
    assert r"\caption{no\_4drot \& more}" in source
    assert source.count("{") == source.count("}")


def test_csv_parses_back_to_full_precision(tmp_path):
    values = [25.123456789, 26.0, 27.5]
    for seed, psnr in enumerate(values):
        write_run(tmp_path / "runs", "dnerf/lego", seed=seed, psnr=psnr)
    assert main([str(tmp_path / "runs")]) == 0
    rows = read_csv(tmp_path / "report/tables/table2_dnerf.csv")
    final = next(r for r in rows if r["method"] == "Ours, fast, final")
    assert float(final["psnr"]) == pytest.approx(statistics.mean(values), rel=1e-12)  # summation order: 1 ulp
    assert float(final["psnr_std"]) == pytest.approx(statistics.stdev(values), rel=1e-12)
    assert final["lpips"] == ""
    assert next(r for r in rows if r["method"] == "4DGS (Wu)") == {
        "kind": "other",
        "method": "4DGS (Wu)",
        "scenes": "8",
        "psnr": "33.30",
        "psnr_std": "",
        "ssim": "0.98",
        "ssim_std": "",
        "lpips": "0.03",
        "note": "⁴",
    }
    for path in (tmp_path / "report/tables").glob("*.csv"):
        assert all(None not in row and None not in row.values() for row in read_csv(path)), path.name


def test_markdown_columns_are_aligned():
    table = Table(
        "t", "T", (Column("a", "A", False), Column("b", "B")), (Row({"a": Cell("x|y"), "b": Cell("1", 1.0)}),)
    )
    lines = [line for line in markdown(table).splitlines() if line.startswith("|")]
    assert len({len(line) for line in lines}) == 1
    assert r"x\|y" in lines[2]
    assert comma_separated(table).splitlines() == ["kind,a,b,note", "ours,x|y,1,"]
