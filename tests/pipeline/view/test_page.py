"""viewer.html as a file: nothing outside it is needed, its parts are joined rightly."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from tiny_film import tiny_film
from viewed import viewed_model, viewed_scene, write_page

import pipeline.view.page as page_module
from pipeline.data.training_views import evenly_spaced
from pipeline.view.cameras import MOST_TRUTHS, _worth_showing, cameras_of
from pipeline.view.page import FOLDER, joined, shader


@pytest.fixture(scope="module")
def text(tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("page") / "viewer.html"
    write_page(path, viewed_scene(), viewed_model("full", count=20))
    return path.read_text(encoding="utf-8")


def test_nothing_outside_is_named(text: str) -> None:
    assert not re.search(r"https?://|//[a-z]+\.|@import|url\(|<script[^>]* src|^import |^export ", text, re.MULTILINE)
    assert set(re.findall(r'<(?:link|img|iframe)[^>]*href="([^"]*)"', text)) == {"data:,"}
    assert "<!-- " not in text  # every part is filled in


def test_each_script_is_joined_once_and_after_what_it_imports() -> None:
    text = joined("main.js")
    order = re.findall(r"^// ---- (\S+)$", text, re.MULTILINE)
    assert sorted(order) == sorted(path.name for path in FOLDER.glob("*.js") if path.name != "sorter.js")
    for file in order:
        for imported in re.findall(r'from "\./([\w-]+\.js)"', (FOLDER / file).read_text()):
            assert order.index(imported) < order.index(file)


def test_a_name_that_two_scripts_declare_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.js").write_text("export const width = 1;\n")
    (tmp_path / "b.js").write_text('import { width } from "./a.js";\n\nfunction width() {}\n')
    monkeypatch.setattr(page_module, "FOLDER", tmp_path)
    with pytest.raises(ValueError, match="page/b.js and page/a.js: both declare width"):
        joined("b.js")


def test_shaders_have_the_kernels_constants() -> None:
    assert f"minAlpha = {1 / 255!r}" in shader("splat.frag") and "maxAlpha = 0.99" in shader("splat.frag")
    assert "frustumMargin = 1.3;" in shader("preprocess.frag")


def test_text_of_a_scene_cannot_end_its_element(tmp_path: Path) -> None:
    scene = viewed_scene()
    views = (replace(scene.train[0], name="train/</script><b>&"), *scene.train[1:])
    write_page(tmp_path / "viewer.html", replace(scene, train=views), viewed_model("full", count=20))
    text = (tmp_path / "viewer.html").read_text(encoding="utf-8")
    header = re.search(r'<script type="application/json" id="header">\n(.*?)\n</script>', text, re.DOTALL)
    assert header is not None
    assert "train/</script><b>&" in {camera["name"] for camera in json.loads(header[1])["scene"]["cameras"]}


def test_a_films_frames_belong_to_its_cameras() -> None:
    film = tiny_film(frames=4)
    cameras = cameras_of(film, 1.0).header
    assert [(camera["name"], camera["split"]) for camera in cameras] == [
        ("test/cam00", "held out"),
        ("test/cam05", "held out"),
        ("train/cam01", "training"),
        ("train/cam02", "training"),
        ("train/cam03", "training"),
    ]
    assert [frame["time"] for frame in cameras[0]["frames"]] == pytest.approx([0, 0.1, 0.2, 0.3])
    assert cameras[1]["frames"][2]["view"] == "test_cam05_0002"


def test_truths_are_bounded_and_held_out_ones_come_first() -> None:
    film = tiny_film(frames=40)
    cameras = cameras_of(film, 0.5)
    known = [(camera["split"], frame["truth"]) for camera in cameras.header for frame in camera["frames"]]
    shown = [split for split, truth in known if truth is not None]
    assert len(shown) == len(cameras.truths) == MOST_TRUTHS and set(shown) == {"held out"}
    assert cameras.header[0]["width"] == 16  # at the scale of training


def test_what_the_report_links_to_has_its_truth() -> None:
    """The pictures of a run are of evenly spaced views, others than those that are embedded for their own sake."""
    for held_out, renders in ((100, 12), (300, 12), (20, 12), (300, 100), (5, 0)):
        found = _worth_showing(held_out, 50, renders)
        assert len(found) == len(set(found)) == MOST_TRUTHS
        pictured = evenly_spaced(held_out, renders)
        assert set(pictured) <= set(found) or len(pictured) > MOST_TRUTHS
