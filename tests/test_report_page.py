"""The HTML page and its strips: self-contained, honest about what it shows, safe from the text of runs."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pandas as pd
from report_runs import write_run

from pipeline.report.__main__ import main
from pipeline.report.strips import DIFFERENCE_GAIN, _shown_schedules, choose_views


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
