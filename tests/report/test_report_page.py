"""The HTML page and its strips: self-contained, honest about what it shows, safe from the text of runs."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
from report_runs import write_run

from pipeline.report.__main__ import main
from pipeline.report.write.strips import DIFFERENCE_GAIN, _shown_schedules, choose_views, make_strips
from pipeline.runs.read.collect import collect


def test_page_is_self_contained_and_carries_everything(tmp_path, capsys):
    for seed in range(3):
        for ablation, psnr in (("full", 30.0), ("no_4drot", 25.0)):
            write_run(tmp_path / "runs", "synthetic/wheel", ablation, seed=seed, psnr=psnr + 0.1 * seed, images=3)
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
        Path(__file__).parents[2] / "pipeline/evaluation/evaluate.py"
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
    more = write_run(tmp_path / "runs", "synthetic/lamp", "no_4dsh", images=2)
    main([str(tmp_path / "runs")])
    assert len(files()) > len(first)
    shutil.rmtree(more)
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


def test_variants_of_a_schedule_have_no_strips_unless_there_is_nothing_else() -> None:
    assert _shown_schedules(pd.Series(["fast", "fast (batch=4)", "paper", "fast"])) == ["fast", "paper"]
    assert _shown_schedules(pd.Series(["fast (batch=4)", "fast (batch=1)"])) == ["fast (batch=1)", "fast (batch=4)"]


# --- as much as there are runs ----------------------------------


def test_the_report_of_one_own_scene_is_a_screen(tmp_path, capsys) -> None:
    write_run(tmp_path / "runs", "dnerf/mine", images=3)
    assert main([str(tmp_path / "runs")]) == 0
    out, text, page = (
        capsys.readouterr().out,
        *((tmp_path / "report" / name).read_text() for name in ("report.md", "report.html")),
    )
    assert len(out.splitlines()) < 25 and len(text.splitlines()) < 70
    for said in (out, text, page):
        for absent in ("Table 1", "Table 2", "Table 3", "no run", "no scene has", "K-Planes", "earn its place"):
            assert absent not in said, absent
    assert not re.search(r"<h2[^>]*>[^<]*</h2>\s*(<h2|</main>)", page)  # no section is empty
    assert re.findall(r'<h2 id="(\w+)">', page) == ["summary", "strips", "curves", "scenes", "raw"]
    assert re.findall(r'<a href="#(\w+)">', page) == ["summary", "strips", "curves", "scenes", "raw"]
    names = {path.name for path in (tmp_path / "report/tables").iterdir()}
    assert names == {
        f"{table}.{suffix}"
        for table in ("scenes_dnerf_own", "all_runs", "provenance")
        for suffix in ("md", "csv", "tex")
    }


def test_without_pictures_and_curves_there_are_no_sections_for_them(tmp_path) -> None:
    folder = write_run(tmp_path / "runs", "dnerf/mine")
    (folder / "error_vs_time.csv").unlink()
    main([str(tmp_path / "runs")])
    page = (tmp_path / "report/report.html").read_text()
    assert re.findall(r'<h2 id="(\w+)">', page) == ["summary", "scenes", "raw"]
    assert "## Pictures" not in (tmp_path / "report/report.md").read_text()


def test_a_single_evaluation_is_no_curve(tmp_path) -> None:
    folder = write_run(tmp_path / "runs", "dnerf/mine")
    lines = (folder / "error_vs_time.csv").read_text().splitlines()
    (folder / "error_vs_time.csv").write_text(f"{lines[0]}\n{lines[-1]}\n")
    main([str(tmp_path / "runs")])
    assert not (tmp_path / "report/plots").exists()


def test_of_many_models_the_page_shows_the_full_ones_and_unfolds_the_others(tmp_path) -> None:
    for scene in ("wheel", "lamp", "burst"):
        for ablation in ("full", "no_4drot", "no_4dsh"):
            write_run(tmp_path / "runs", f"synthetic/{scene}", ablation, images=2)
    main([str(tmp_path / "runs")])
    page = (tmp_path / "report/report.html").read_text()
    shown = re.sub(r"<details>.*?</details>", "", page, flags=re.DOTALL)
    captions = r"<figcaption><b>([^<]*)</b>"
    assert re.findall(captions, shown) == ["full"] * 6
    assert sorted(re.findall(captions, page)) == ["full"] * 6 + ["no_4drot"] * 3 + ["no_4dsh"] * 3


def test_pictures_without_a_full_model_are_of_the_first(tmp_path) -> None:
    write_run(tmp_path, "synthetic/wheel", "no_4drot", images=3)
    write_run(tmp_path, "synthetic/wheel", "no_4dsh", images=3)
    strips, _ = make_strips(collect(tmp_path).runs)
    assert [(s.ablation, s.why, s.said) for s in strips] == [
        ("no_4drot", "median", "median"),
        ("no_4drot", "worst", "worst"),
        ("no_4dsh", "median", "median of no_4drot"),
    ]


def test_a_reader_that_stops_gets_no_traceback_and_the_files_are_there(tmp_path) -> None:
    write_run(tmp_path / "runs", "dnerf/mine")
    process = subprocess.Popen(
        [sys.executable, "-m", "pipeline.report", str(tmp_path / "runs")],
        cwd=Path(__file__).parents[2],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    process.stdout.close()  # before the report has a word to say
    assert process.stderr.read() == "" and process.wait(timeout=120) == 141
    assert (tmp_path / "report/report.html").read_text().rstrip().endswith("</html>")


def test_a_name_that_no_file_can_have_is_shortened(tmp_path) -> None:
    write_run(tmp_path / "runs", "dnerf/mine", out="a", train="fast" * 60, images=2)
    write_run(tmp_path / "runs", "dnerf/mine", out="b", train="fast" * 60 + "er", images=2)
    assert main([str(tmp_path / "runs")]) == 0
    assert len(list((tmp_path / "report/strips").iterdir())) == 4  # both schedules'
