"""The HTML page and the image strips: self-contained, escaped, only sections with content."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
from report_runs import write_run

from pipeline.report.__main__ import main
from pipeline.report.runs import collect
from pipeline.report.strips import DIFFERENCE_GAIN, choose_views, make_strips, shown_experiment


def test_page_is_self_contained(tmp_path, capsys):
    for seed in range(3):
        for ablation, psnr in (("full", 30.0), ("no_4drot", 25.0)):
            write_run(
                tmp_path / "runs",
                "synthetic/wheel",
                ablation,
                seed=seed,
                psnr=psnr + 0.1 * seed * (ablation == "full"),
                images=3,
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
    assert "no_4drot on synthetic/wheel: worse, -5.10 ± 0.25 dB (fast)" in capsys.readouterr().out


def test_strips_link_to_the_runs_viewer(tmp_path):
    folder = write_run(tmp_path / "runs", "synthetic/wheel", images=3)
    (folder / "viewer.html").touch()
    write_run(tmp_path / "runs", "synthetic/lamp", images=3)  # from before there was one
    assert main([str(tmp_path / "runs"), "--out", str(tmp_path / "else where")]) == 0
    page = (tmp_path / "else where/report.html").read_text()
    links = re.findall(r'<a href="([^"#]+)#([^"]+)">in the viewer</a>', page)
    assert len(links) == 2  # of one run's median and worst view
    for path, view in links:
        assert (tmp_path / "else where" / path).samefile(folder / "viewer.html")
        assert re.fullmatch(r"view=test_r_\d&amp;compare=wipe", view)


def test_median_and_worst_view_are_chosen_by_psnr(tmp_path):
    folder = write_run(tmp_path, "synthetic/wheel", images=3)
    assert choose_views(folder / "renders", {"test_r_0": 30.0, "test_r_1": 20.0, "test_r_2": 25.0}) == [
        ("median", "test_r_2"),
        ("worst", "test_r_1"),
    ]
    assert choose_views(folder / "renders", {}) == [("example", "test_r_1")]


def test_difference_gain_is_that_of_the_evaluation():
    # Read as text, since importing the module needs the compiled rasterizer.
    source = (Path(__file__).parents[3] / "pipeline/evaluation/pictures/view_pictures.py").read_text()
    assert int(re.search(r"^DIFFERENCE_GAIN = (\d+)", source, re.M)[1]) == DIFFERENCE_GAIN


def test_text_of_a_run_is_escaped(tmp_path):
    write_run(tmp_path / "runs", "synthetic/<b>&x", out="odd", recipe="a|b")
    assert main([str(tmp_path / "runs")]) == 0
    page = (tmp_path / "report/report.html").read_text()
    assert "<b>&x" not in page and "&lt;b&gt;&amp;x" in page


def test_repeated_report_is_identical_and_has_no_stale_strip(tmp_path):
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


def test_pictures_of_a_family_can_be_excluded(tmp_path, capsys):
    write_run(tmp_path / "runs", "dnerf/lego", images=2)
    write_run(tmp_path / "runs", "synthetic/wheel", images=2)
    assert main([str(tmp_path / "runs"), "--no-pictures", "dnerf"]) == 0
    assert [p.name.split("__")[0] for p in (tmp_path / "report/strips").glob("*.webp")] == ["synthetic_wheel"] * 2
    assert "dnerf/lego: no pictures" in capsys.readouterr().err


def test_strips_are_of_the_recipe_with_the_best_final_psnr_of_full() -> None:
    def best(*rows: tuple[str, bool, str, float]) -> tuple[str, str]:
        runs = pd.DataFrame(rows, columns=["recipe_label", "changed", "model", "final.psnr"])
        return shown_experiment(runs.assign(images="rendered", protocol="dnerf-400-black-v1"))

    def fast(change: str, psnr: float) -> tuple[str, bool, str, float]:
        return (f"fast ({change})", True, "full", psnr)

    of_full = ("fast", False, "full", 30.0), ("fast", False, "full", 20.0), ("paper", False, "full", 26.0)
    assert best(*of_full) == ("paper", "full")  # means
    assert best(("fast", False, "full", 25.0), ("paper", False, "no_4dsh", 26.0)) == ("fast", "full")
    assert best(("fast", False, "full", 25.0), fast("batch=4", 26.0)) == ("fast", "full")  # changes do not count
    assert best(fast("batch=1", 25.0), fast("batch=4", 26.0)) == ("fast (batch=4)", "full")


# --- only what has runs ----------------------------------


def test_report_of_one_scene_is_short(tmp_path, capsys) -> None:
    write_run(tmp_path / "runs", "dnerf/mine", images=3)
    assert main([str(tmp_path / "runs")]) == 0
    out, text, page = (
        capsys.readouterr().out,
        *((tmp_path / "report" / name).read_text() for name in ("report.md", "report.html")),
    )
    assert len(out.splitlines()) < 25 and len(text.splitlines()) < 70
    for document in (out, text, page):
        for absent in ("Table 1", "Table 2", "Table 3", "no run of", "K-Planes", "Ablations"):
            assert absent not in document, absent
    assert not re.search(r"<h2[^>]*>[^<]*</h2>\s*(<h2|</main>)", page)  # no section is empty
    assert re.findall(r'<h2 id="(\w+)">', page) == ["summary", "strips", "curves", "scenes", "raw"]
    assert re.findall(r'<a href="#(\w+)">', page) == ["summary", "strips", "curves", "scenes", "raw"]
    names = {path.name for path in (tmp_path / "report/tables").iterdir()}
    assert names == {
        f"{table}.{suffix}" for table in ("scenes_monocular", "all_runs", "provenance") for suffix in ("md", "csv")
    }


def test_no_sections_without_pictures_and_curves(tmp_path) -> None:
    folder = write_run(tmp_path / "runs", "dnerf/mine")
    (folder / "error_vs_time.csv").unlink()
    main([str(tmp_path / "runs")])
    page = (tmp_path / "report/report.html").read_text()
    assert re.findall(r'<h2 id="(\w+)">', page) == ["summary", "scenes", "raw"]
    assert "## Held-out views" not in (tmp_path / "report/report.md").read_text()


def test_no_curve_of_a_single_evaluation(tmp_path) -> None:
    folder = write_run(tmp_path / "runs", "dnerf/mine")
    lines = (folder / "error_vs_time.csv").read_text().splitlines()
    (folder / "error_vs_time.csv").write_text(f"{lines[0]}\n{lines[-1]}\n")
    main([str(tmp_path / "runs")])
    assert not (tmp_path / "report/plots").exists()


def test_only_the_ablation_made_for_a_scene_has_a_strip(tmp_path) -> None:
    for scene in ("wheel", "lamp", "burst"):
        for ablation in ("full", "no_4drot", "no_4dsh"):
            write_run(tmp_path / "runs", f"synthetic/{scene}", ablation, images=2)
    main([str(tmp_path / "runs")])
    page = (tmp_path / "report/report.html").read_text()
    captions = re.findall(r"<figcaption><b>([^<]*)</b>", page)
    assert captions == ["full", "full", "no_4drot"] + ["full", "full", "no_4dsh"] + ["full", "full"]
    assert (tmp_path / "report/report.md").read_text().count("](strips/") == 8


def test_strips_without_a_full_model_are_of_the_first_model(tmp_path) -> None:
    write_run(tmp_path, "synthetic/wheel", "no_4drot", images=3)
    write_run(tmp_path, "synthetic/wheel", "no_4dsh", images=3)
    strips, _ = make_strips(collect(tmp_path).runs)
    assert [(s.model, s.choice_text) for s in strips] == [("no_4drot", "median"), ("no_4drot", "worst")]


def test_missing_image_gives_a_warning(tmp_path) -> None:
    folder = write_run(tmp_path, "synthetic/wheel", images=3)
    (folder / "renders/test_r_0_truth.png").unlink()
    strips, warnings = make_strips(collect(tmp_path).runs)
    assert [s.choice for s in strips] == ["median"]
    assert len(warnings) == 1 and "no strip of test_r_0" in warnings[0]


def test_closed_pipe_gives_no_traceback_and_all_files(tmp_path) -> None:
    write_run(tmp_path / "runs", "dnerf/mine")
    process = subprocess.Popen(
        [sys.executable, "-m", "pipeline.report", str(tmp_path / "runs")],
        cwd=Path(__file__).parents[3],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    process.stdout.close()  # before the report prints anything
    assert process.stderr.read() == "" and process.wait(timeout=120) == 141
    assert (tmp_path / "report/report.html").read_text().rstrip().endswith("</html>")


def test_long_names_of_files_are_shortened(tmp_path) -> None:
    write_run(tmp_path / "runs", "dnerf/a", recipe="fast" * 60, out="a", images=2)
    write_run(tmp_path / "runs", "dnerf/b", recipe="fast" * 60 + "er", out="b", images=2)
    assert main([str(tmp_path / "runs")]) == 0
    assert len(list((tmp_path / "report/strips").iterdir())) == 4
