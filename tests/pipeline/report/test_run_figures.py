"""The report's section of the figures that pipeline.figures wrote: of which run, and damaged ones."""

from __future__ import annotations

import json
from pathlib import Path

from PIL import Image
from report_runs import write_run

from pipeline.report.build import build_report
from pipeline.report.runs import collect
from pipeline.report.strips import run_figures


def write_figures(folder: Path, seen: str = "It moves.") -> Path:
    (folder / "figures").mkdir()
    Image.new("RGB", (80, 40), (200, 30, 30)).save(folder / "figures/flow.png")
    index = [{"file": "flow.png", "title": "Optical flow", "seen": seen}]
    (folder / "figures/figures.json").write_text(json.dumps(index))
    return folder


def test_they_are_of_the_run_whose_views_are_shown(tmp_path: Path) -> None:
    write_figures(write_run(tmp_path, "synthetic/wheel", recipe="short", psnr=20.0), "Of short.")
    write_figures(write_run(tmp_path, "synthetic/wheel", recipe="fast", psnr=25.0), "Of <fast>.")
    write_figures(write_run(tmp_path, "synthetic/lamp", "no_4dsh"), "Of the only one.")
    write_run(tmp_path, "synthetic/lamp", "full")
    found, warnings = run_figures(collect(tmp_path).runs)
    assert not warnings and [figure.seen for figure in found] == ["Of <fast>.", "Of the only one."]
    report = build_report([tmp_path])
    assert "strips/synthetic_wheel__figures__flow.webp" in report.files
    page = report.files["report.html"].decode()
    assert "Motion and time" in page and "Of &lt;fast&gt;." in page and "Of <fast>" not in page
    assert run_figures(collect(tmp_path).runs, ("synthetic",)) == ([], [])


def test_damaged_ones_give_a_warning(tmp_path: Path) -> None:
    folder = write_figures(write_run(tmp_path, "synthetic/wheel"))
    (folder / "figures/flow.png").write_bytes(b"no picture")
    found, (warning,) = run_figures(collect(tmp_path).runs)
    assert not found and "no figures: " in warning
    for content in ('{"file": 1}', '[{"file": "flow.png"}]', "no json"):
        (folder / "figures/figures.json").write_text(content)
        found, (warning,) = run_figures(collect(tmp_path).runs)
        assert not found and "figures.json: expected" in warning


def test_a_report_without_figures_has_no_section(tmp_path: Path) -> None:
    write_run(tmp_path, "synthetic/wheel")
    assert "Motion and time" not in build_report([tmp_path]).files["report.html"].decode()
