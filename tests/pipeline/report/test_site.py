"""The site: every link leads to a file, leaderboards rank one protocol each, and pages fit a telephone's screen."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from urllib.parse import unquote

import pytest
from playwright.sync_api import Browser
from report_runs import write_run

from pipeline.report.__main__ import main
from pipeline.report.leaderboard import leaderboards
from pipeline.report.runs import collect

TELEPHONE, DESK = 390, 1280  # pixels


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("site") / "runs"
    for scene, better in (("dnerf/hook", 0.0), ("dnerf/lego", 2.0)):
        for seed in (0, 1):
            folder = write_run(root, scene, psnr=30 + better + seed, seed=seed, images=3)
            (folder / "viewer.html").write_text(f"viewer of {scene}, seed {seed}")
            (folder / "renders/cam00_render_and_truth.mp4").write_bytes(b"film")
        write_run(root, scene, recipe="a-very-long-name-of-a-method_with=parts", psnr=28 + better, images=1)
    folder = write_run(root, "dnerf/hook", "given", "theirs", psnr=40.0, images=1)
    metrics = folder / "metrics.json"
    metrics.write_text(metrics.read_text().replace('"scene"', '"images": "given", "scene"', 1))
    write_run(root, "dnerf/hook", recipe="white", psnr=50.0, protocol="dnerf-400-white-v1")
    write_run(root, "synthetic/wheel", images=1)
    return root


@pytest.fixture(scope="module")
def site(root: Path) -> Path:
    assert main([str(root), "--site", str(root.parent / "site")]) == 0
    return root.parent / "site"


def test_a_leaderboard_is_of_one_protocol_and_ranks_methods_of_all_its_scenes(root: Path) -> None:
    found = {table.title: table.rows for table in leaderboards(collect(root).runs)}
    assert list(found) == ["dnerf-400-black-v1", "dnerf-400-white-v1", "synthetic-v1"]
    rows = [
        tuple(row.cells[key].text for key in ("rank", "method", "images", "scenes"))
        for row in found["dnerf-400-black-v1"]
    ]
    assert rows == [
        ("1", "fast, full", "rendered", "2 of 2"),
        ("2", "a-very-long-name-of-a-method_with=parts, full", "rendered", "2 of 2"),
        ("·", "theirs", "images given", "1 of 2"),  # the best PSNR, but of one scene
    ]
    assert [row.cells["final.psnr"].value for row in found["dnerf-400-black-v1"]] == [31.5, 29.0, 40.0]


def test_every_link_leads_to_a_file_of_the_site(site: Path) -> None:
    pages = sorted(path.name for path in site.glob("*.html"))
    assert pages == [
        "dnerf.html",
        "dnerf__hook.html",
        "dnerf__lego.html",
        "index.html",
        "synthetic.html",
        "synthetic__wheel.html",
    ]
    linked = set()
    for page in pages:
        text = (site / page).read_text()
        targets = re.findall(r'(?:href|src)="((?!data:)[^"]+)"', text)
        assert not re.search(r"<script|https?://", text)
        for target in targets:
            file, _, anchor = target.partition("#")
            assert (site / (unquote(file) or page)).is_file(), (page, target)
            assert file or f'id="{anchor}"' in text, (page, target)
            linked.add(unquote(file))
    files = {path.relative_to(site).as_posix() for path in site.rglob("*") if path.is_file()}
    assert files - linked == {"report_files.txt"}


def test_a_scene_has_its_viewer_its_film_and_every_command(site: Path) -> None:
    page = (site / "dnerf__hook.html").read_text()
    assert (site / "viewers/dnerf__hook.html").read_text() == "viewer of dnerf/hook, seed 0"
    assert (site / "films/dnerf__hook__cam00_render_and_truth.mp4").read_bytes() == b"film"
    assert page.count("<video") == 1 and page.count(">in the viewer</a>") == 2 and "dnerf/lego" not in page
    assert all(f"python -m pipeline scene=dnerf/hook seed={seed}" in page for seed in (0, 1))


def test_scenes_without_pictures_have_neither_viewer_nor_film(root: Path, tmp_path: Path) -> None:
    assert main([str(root), "--site", str(tmp_path), "--no-pictures", "dnerf"]) == 0
    assert not (tmp_path / "viewers").exists() and not (tmp_path / "films").exists()
    assert "data:image/webp" not in (tmp_path / "dnerf__hook.html").read_text()


def test_a_site_replaces_its_own_files_alone(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    shutil.copytree(root, tmp_path / "runs")
    own = [str(tmp_path / "runs"), "--site", str(tmp_path / "site")]
    assert main(own) == 0
    shutil.rmtree(tmp_path / "runs/dnerf/lego")
    assert main(own) == 0 and not (tmp_path / "site/dnerf__lego.html").exists()
    (tmp_path / "other").mkdir()
    (tmp_path / "other/index.html").write_text("mine")
    assert main([*own[:2], str(tmp_path / "other")]) == 1
    assert "found another file" in capsys.readouterr().err
    assert (tmp_path / "other/index.html").read_text() == "mine"


@pytest.mark.parametrize("width", [TELEPHONE, DESK])
def test_no_page_is_wider_than_the_screen(site: Path, browser: Browser, width: int) -> None:
    """Wide tables scroll in a box of their own; text is no smaller than 12 pixels, columns of names can be read."""
    with browser.new_context(viewport={"width": width, "height": 800}) as context:
        page = context.new_page()
        for path in sorted(site.glob("*.html")):
            page.goto(path.as_uri())
            assert page.evaluate("document.scrollingElement.scrollWidth") <= width, path.name
            smallest = page.evaluate(
                "Math.min(...[...document.querySelectorAll('td, th, p, a, li')]"
                ".map(e => parseFloat(getComputedStyle(e).fontSize)))"
            )
            assert smallest >= 12
        page.goto((site / "index.html").as_uri())
        page.click("a.card >> nth=0")
        page.click("a.card >> nth=0")
        assert page.title() == "synthetic/wheel"
        page.click("nav.above a >> nth=0")
        assert page.title() == "4D Gaussian Splatting: results"
