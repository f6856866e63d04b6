"""The report: numbers against hand computation, files that other programs can read, honest gaps.

Run folders are written here, file by file, in the format a run leaves them in: the report reads files only,
so this is the whole of its input.
"""

from __future__ import annotations

import csv
import json
import math
import re
import statistics
from decimal import ROUND_HALF_UP, Decimal
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pipeline.report import paper, scenes
from pipeline.report.__main__ import main
from pipeline.report.aggregate import compare, estimate, over_scenes
from pipeline.report.collect import collect
from pipeline.report.export import comma_separated, escape, latex, markdown
from pipeline.report.plots import band
from pipeline.report.run_tables import verdicts
from pipeline.report.strips import DIFFERENCE_GAIN, choose_views
from pipeline.report.table import Cell, Column, Row, Table
from pipeline.report.tables import dnerf, paper_tables
from pipeline.report.variants import name_variants


def write_run(
    root: Path,
    scene: str,
    ablation: str = "full",
    train: str = "fast",
    seed: int = 0,
    psnr: float = 25.0,
    out: str | None = None,
    iterations: int = 1000,
    images: int = 0,
    **changes,
) -> Path:
    """One run folder; `changes` replace keys of metrics.json (dotted keys reach inside)."""
    folder = root / (out or f"{scene}/{ablation}/{train}/seed{seed}")
    (folder / "renders").mkdir(parents=True)
    quality = {
        "psnr": psnr,
        "ssim": 0.9,
        "ms_ssim": 0.96,
        "dssim1": 0.05,
        "dssim2": 0.04,
        "lpips_alex": None,
        "lpips_vgg": None,
        "lpips_note": "no weights: offline",
        "fps_raster": 80.0,
        "fps_render": 60.0,
    }
    metrics = {
        "final": dict(quality),
        "best_on_test": quality | {"psnr": psnr + 0.25, "iteration": 800},
        "n_gaussians": 12345,
        "n_alive_mean": 6000.5,
        "train_seconds": 60.0 + seed,
        "peak_rss_mb": 512.0,
        "model_mb": 7.5,
        "model_with_optimiser_mb": 22.5,
        "iterations": iterations,
        "scene": scene,
        "ablation": ablation,
        "train": train,
        "seed": seed,
    }
    for key, value in changes.items():
        *path, last = key.split(".")
        part = metrics
        for name in path:
            part = part[name]
        part[last] = value
    (folder / "metrics.json").write_text(json.dumps(metrics))
    (folder / "config.yaml").write_text(
        f"seed: {seed}\nthreads: 2\nscene:\n  name: {scene}\n  path: null\nablation:\n  name: {ablation}\n"
        f"train:\n  name: {train}\n  iterations: {iterations}\n"
    )
    rows = ["train_seconds,iteration,psnr,ssim,test_loss,n_gaussians"]
    rows += [
        f"{(60 + seed) * k / 4},{iterations * k // 4},{psnr - 8 / k + 2},{0.8},{0.1},{3000 * k}"
        for k in (1, 2, 3, 4)
    ]
    (folder / "error_vs_time.csv").write_text("\n".join(rows) + "\n")
    (folder / "environment.json").write_text(
        json.dumps(
            {
                "machine": "Test CPU, 2 cores",
                "date": f"2025-01-0{seed + 1}T10:00:00Z",
                "git_commit": "abc1234",
                "command": f"python -m pipeline scene={scene} seed={seed}",
                "versions": {},
            }
        )
    )
    per_image = ["view,psnr"]
    for i in range(images):
        per_image.append(f"test/r_{i},{psnr + i}")
        for part, shade in (("render", 90), ("truth", 120), ("difference", 30)):
            pixels = np.full((24, 24, 3), shade + i, np.uint8)
            Image.fromarray(pixels).save(folder / "renders" / f"test_r_{i}_{part}.png")
    (folder / "per_image.csv").write_text("\n".join(per_image) + "\n")
    return folder


def read_csv(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def half_up(value: float, places: str = "0.01") -> float:
    """Rounds as people print: 32.005 -> 32.01 (binary floats and banker's rounding would say 32.00)."""
    return float(Decimal(repr(round(value, 9))).quantize(Decimal(places), ROUND_HALF_UP))


# --- statistics -------------------------------------------------


def test_mean_std_and_standard_error_by_hand():
    found = estimate([24.0, 25.0, 27.0])
    assert found.mean == pytest.approx(76 / 3)
    assert found.std == pytest.approx(statistics.stdev([24.0, 25.0, 27.0]))
    assert found.standard_error == pytest.approx(math.sqrt(7 / 3) / math.sqrt(3))  # variance by hand: 7/3
    assert math.isnan(estimate([24.0]).std)
    assert estimate([24.0, math.nan]) is None  # a mean over some of the seeds is not the mean


def test_verdict_follows_the_two_standard_error_rule():
    full = estimate([26.0, 26.2, 26.4])  # std 0.2
    # SE of the difference = sqrt(0.04 / 3 + 0.04 / 3) = 0.16330, so the line lies at 0.32660 dB
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
    write_run(
        tmp_path, "dnerf/hook", seed=2, psnr=34.0
    )  # a third seed of one scene must not weigh that scene more
    found, count = over_scenes(collect(tmp_path).runs, scenes.DNERF, "full", "fast", "final.psnr")
    assert count == 2
    assert found.mean == pytest.approx((25.5 + 32.0) / 2)
    assert found.std == pytest.approx(statistics.stdev([27.5, 29.0]))  # seeds 0 and 1, which both scenes have


def test_band_interpolates_between_the_seeds_evaluations(tmp_path):
    write_run(tmp_path, "synthetic/wheel", seed=0)
    write_run(tmp_path, "synthetic/wheel", seed=1, psnr=26.0)
    x, mean, std = band(collect(tmp_path).curves, "iteration", "psnr")
    # both curves have the same iterations and lie 1 dB apart everywhere: the std of (a, a + 1) is sqrt(1/2)
    assert (x[0], x[-1]) == (250, 1000)
    np.testing.assert_allclose(std, math.sqrt(0.5))
    assert mean[-1] == pytest.approx(25.5)


# --- the paper's numbers ----------------------------------------


def test_paper_scene_numbers_average_to_the_printed_means():
    for row in paper.read("table1_per_scene"):
        values = [float(row[scenes.short(s)]) for s in scenes.PLENOPTIC if row[scenes.short(s)]]
        # Printed to 0.01, so within 0.005; HexPlane's 31.706 is printed 31.70 (footnote ³): 0.0061.
        assert abs(statistics.mean(values) - float(row["printed_mean"])) < (
            0.0061 if row["note"] == "³" else 0.00501
        )


def test_paper_table_1_and_its_scene_table_agree():
    per_scene = {row["method"]: row["printed_mean"] for row in paper.read("table1_per_scene")}
    table = {row["method"].removesuffix("-L"): row["psnr"] for row in paper.read("table1_plenoptic")}
    assert all(table[method] == mean for method, mean in per_scene.items())
    assert table["4DGS (this paper)"] == "32.01"


def test_paper_misprint_is_corrected_and_said():
    row = next(r for r in paper.read("table3_ablation") if r["ablation"] == "no_time_split")
    mean = (float(row["flame_salmon_psnr"]) + float(row["cut_roasted_beef_psnr"])) / 2
    assert half_up(mean) == float(row["corrected_mean_psnr"]) == 30.88
    assert row["printed_mean_psnr"] == "30.25"
    assert "30.25" in dict(paper.footnotes("⁶"))["⁶"]


def test_paper_table_2_row_for_row():
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


def test_cells_without_a_run_are_empty_and_said_so(tmp_path):
    write_run(tmp_path, "synthetic/still")
    for table in paper_tables(collect(tmp_path).runs):
        ours = [row for row in table.rows if row.kind == "ours"]
        assert ours and all(cell.value is None for row in ours for cell in row.cells.values())
        assert ("", "Empty cell: no run.") in table.footnotes


def test_table_2_says_over_how_many_scenes_its_mean_is(tmp_path):
    write_run(tmp_path, "dnerf/lego", psnr=26.5)
    table = dnerf(collect(tmp_path).runs)
    final, best = [row.cells for row in table.rows if row.kind == "ours"]
    assert final["scenes"].text == "mean of 1 of 8"
    assert (final["psnr"].text, best["psnr"].text) == (
        "26.50",
        "26.75",
    )  # final above best on test, one seed: no ±
    assert final["lpips"].text == "n/a"  # there is a run, but nothing to measure LPIPS with


def test_verdict_table_names_what_does_not_hold(tmp_path):
    for seed in range(3):
        write_run(tmp_path, "synthetic/wheel", "full", seed=seed, psnr=30 + 0.1 * seed)
        write_run(tmp_path, "synthetic/wheel", "no_4drot", seed=seed, psnr=25 + 0.1 * seed)
        write_run(tmp_path, "synthetic/lamp", "full", seed=seed, psnr=30 + 0.1 * seed)
        write_run(tmp_path, "synthetic/lamp", "no_4dsh", seed=seed, psnr=30 + 0.1 * seed)
    words = [row.cells["verdict"].text for row in verdicts(collect(tmp_path).runs).rows]
    assert words == ["worse, as it should be"] * 2 + ["NOT shown to be worse"] * 2 + ["no run"]


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
    assert float(final["psnr"]) == pytest.approx(
        statistics.mean(values), rel=1e-12
    )  # the order of a sum: 1 ulp
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


def test_markdown_is_one_grid():
    table = Table(
        "t", "T", (Column("a", "A", False), Column("b", "B")), (Row({"a": Cell("x|y"), "b": Cell("1", 1.0)}),)
    )
    lines = [line for line in markdown(table).splitlines() if line.startswith("|")]
    assert len({len(line) for line in lines}) == 1
    assert r"x\|y" in lines[2]
    assert comma_separated(table).splitlines() == ["kind,a,b,note", "ours,x|y,1,"]


# --- runs that are not what they seem ---------------------------


@pytest.mark.parametrize(
    "damage, said",
    [
        (lambda f: (f / "metrics.json").unlink(), "unfinished: no metrics.json"),
        (lambda f: (f / "metrics.json").write_text('{"final": '), "expected JSON"),
        (lambda f: (f / "metrics.json").write_text("[1]"), "expected an object, found list"),
        (
            lambda f: (f / "metrics.json").write_text(
                (f / "metrics.json").read_text().replace("25.0", "NaN")
            ),
            "final.psnr: expected a finite number, found nan",
        ),
        (
            lambda f: (f / "metrics.json").write_text(
                (f / "metrics.json").read_text().replace("12345", '"many"')
            ),
            "n_gaussians: expected a finite number, found 'many'",
        ),
        (lambda f: (f / "config.yaml").write_text("a: [1"), "config.yaml: expected YAML"),
    ],
)
def test_a_broken_run_is_named_in_one_line_and_left_out(tmp_path, capsys, damage, said):
    write_run(tmp_path, "synthetic/wheel", seed=0)
    damage(write_run(tmp_path, "synthetic/wheel", seed=1))
    found = collect(tmp_path)
    assert list(found.runs["seed"]) == [0]  # the other run still counts
    assert len(found.left_out) == 1 and "\n" not in found.left_out[0]
    assert found.left_out[0].startswith("synthetic/wheel/full/fast/seed1: left out: ")
    assert said in found.left_out[0]


def test_a_broken_run_is_named_on_stderr_and_in_the_report(tmp_path, capsys):
    write_run(tmp_path / "runs", "synthetic/wheel", seed=0)
    (write_run(tmp_path / "runs", "synthetic/wheel", seed=1) / "metrics.json").unlink()
    assert main([str(tmp_path / "runs")]) == 0
    line = "synthetic/wheel/full/fast/seed1: left out: unfinished: no metrics.json"
    assert capsys.readouterr().err == f"warning: {line}\n"
    assert all(line in (tmp_path / "report" / name).read_text() for name in ("report.html", "report.md"))


def test_a_damaged_curve_costs_the_curve_not_the_run(tmp_path):
    folder = write_run(tmp_path, "synthetic/wheel")
    with (folder / "error_vs_time.csv").open("a") as file:
        file.write("70.0,1100\n")
    found = collect(tmp_path)
    assert len(found.runs) == 1 and found.curves.empty
    assert found.warnings == (
        "synthetic/wheel/full/fast/seed0: error_vs_time.csv: expected numbers, found none in line 6",
    )


def test_a_curve_line_cut_short_by_a_kill_is_dropped(tmp_path):
    folder = write_run(tmp_path, "synthetic/wheel")
    with (folder / "error_vs_time.csv").open("a") as file:
        file.write("70.0,1100,25.1,0.8,0.1,12")  # the count was to be 12345
    found = collect(tmp_path)
    assert list(found.curves["iteration"]) == [250, 500, 750, 1000] and not found.warnings


@pytest.mark.parametrize(
    "make",
    [
        lambda p: None,
        lambda p: p.mkdir(),
        lambda p: p.write_text("x"),
        lambda p: (p / "a").mkdir(parents=True) or (p / "a/config.yaml").write_text(""),
    ],
)
def test_nothing_to_report_is_one_line_and_a_failure(tmp_path, capsys, make):
    make(tmp_path / "runs")
    assert main([str(tmp_path / "runs")]) == 1
    said = capsys.readouterr().err
    assert said.startswith(f"error: {tmp_path / 'runs'}: expected") and said.count("\n") == 1
    assert not (tmp_path / "report").exists()


def test_runs_with_other_settings_are_not_averaged_under_one_name(tmp_path):
    write_run(tmp_path, "synthetic/wheel", seed=0)
    write_run(tmp_path, "synthetic/wheel", seed=1)
    write_run(tmp_path, "synthetic/wheel", seed=2, iterations=600)
    runs = name_variants(collect(tmp_path)).runs
    assert sorted(runs["train"]) == ["fast", "fast", "fast (iterations=600)"]


def test_a_copied_run_counts_once(tmp_path):
    write_run(tmp_path, "synthetic/wheel")
    write_run(tmp_path, "synthetic/wheel", out="copy")
    found = name_variants(collect(tmp_path))
    assert len(found.runs) == 1
    assert found.left_out == (
        "synthetic/wheel/full/fast/seed0: left out: same scene, ablation, settings and seed as copy",
    )


# --- the page ---------------------------------------------------


def test_page_is_self_contained_and_carries_everything(tmp_path, capsys):
    for seed in range(3):
        for ablation, psnr in (("full", 30.0), ("no_4drot", 25.0)):
            write_run(
                tmp_path / "runs", "synthetic/wheel", ablation, seed=seed, psnr=psnr + 0.1 * seed, images=3
            )
    assert main([str(tmp_path / "runs"), "--out", str(tmp_path / "elsewhere")]) == 0
    page = (tmp_path / "elsewhere/report.html").read_text()
    sources = re.findall(r'(?:src|srcset|href|data|action)\s*=\s*"([^"]*)"', page)
    assert sources and all(s.startswith(("data:image/", "#")) for s in sources)
    assert not re.search(r"<script|<link|@import|url\(", page)
    # full: median and worst view; the ablation: the same median view. Two themes of one plot.
    assert page.count("data:image/webp;base64,") == 3 and page.count("data:image/svg+xml;base64,") == 2
    assert "Test CPU, 2 cores" in page and "2025-01-01" in page and "abc1234" in page
    assert "python -m pipeline scene=synthetic/wheel seed=2" in page
    anchors = set(re.findall(r'href="#([^"]+)"', page))
    assert anchors and anchors <= set(re.findall(r'id="([^"]+)"', page))
    assert len(list((tmp_path / "elsewhere/strips").glob("*.webp"))) == 3
    assert "worse, as it should be" in capsys.readouterr().out  # the tables are printed too


def test_strip_shows_the_median_and_the_worst_view(tmp_path):
    folder = write_run(tmp_path, "synthetic/wheel", images=3)
    assert choose_views(folder / "renders", {"test_r_0": 30.0, "test_r_1": 20.0, "test_r_2": 25.0}) == [
        ("median", "test_r_2"),
        ("worst", "test_r_1"),
    ]
    assert choose_views(folder / "renders", {}) == [("shown", "test_r_1")]


def test_the_page_names_the_gain_that_difference_images_have():
    source = (
        Path(__file__).parents[1] / "pipeline/evaluate.py"
    ).read_text()  # read: importing it needs the kernel
    assert int(re.search(r"^DIFFERENCE_GAIN = (\d+)", source, re.M)[1]) == DIFFERENCE_GAIN


def test_text_from_a_run_cannot_break_the_page(tmp_path):
    write_run(tmp_path / "runs", "synthetic/<b>&x", out="odd", train="a|b")
    assert main([str(tmp_path / "runs")]) == 0
    page = (tmp_path / "report/report.html").read_text()
    assert "<b>&x" not in page and "&lt;b&gt;&amp;x" in page


def test_a_second_report_is_the_same_and_leaves_no_stale_strip(tmp_path):
    def files() -> dict[Path, bytes]:
        return {path: path.read_bytes() for path in (tmp_path / "report").rglob("*") if path.is_file()}

    write_run(tmp_path / "runs", "synthetic/wheel", images=2)
    main([str(tmp_path / "runs")])
    first = files()
    (tmp_path / "report/strips/stale.webp").write_bytes(b"")
    main([str(tmp_path / "runs")])
    second = files()
    assert first.keys() == second.keys()
    assert [path.name for path in first if first[path] != second[path]] == []


def test_pictures_of_a_family_can_be_left_out(tmp_path, capsys):
    write_run(tmp_path / "runs", "dnerf/lego", images=2)
    write_run(tmp_path / "runs", "synthetic/wheel", images=2)
    assert main([str(tmp_path / "runs"), "--no-pictures", "dnerf"]) == 0
    assert [p.name.split("__")[0] for p in (tmp_path / "report/strips").glob("*.webp")] == ["synthetic_wheel"] * 2
    assert "dnerf/lego: pictures left out" in capsys.readouterr().err
