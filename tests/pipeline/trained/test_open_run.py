"""A finished run whose data set has moved: what is in its folder is enough, and what is not is said."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from shell import TINY, Shell

from datasets.files.errors import DataError, SceneError
from pipeline.data.prepare import prepare
from pipeline.data.stored_scene import SCALARS, read_scene, to_dict
from pipeline.export.__main__ import main as export
from pipeline.figures.__main__ import main as figures
from pipeline.render import main as render
from pipeline.trained.open_run import open_run, stored_config
from pipeline.view.__main__ import main as view

COMMAND = ("scene=dnerf", "scene.name=dnerf/mine", *TINY[1:], "train.iterations=20", "scene.downscale=1", "out=run")


@pytest.fixture(scope="module")
def moved(tmp_path_factory) -> Path:
    """A folder with `run`, of `before`, which is `after` now; and what was made of it before."""
    shell = Shell(tmp_path_factory.mktemp("moved"))
    shell(*TINY, "train.iterations=1", "out=made", "until=prepare")
    next((shell.folder / "results/cache").iterdir()).rename(shell.folder / "before")
    shell(*COMMAND, f"scene.path={shell.folder}/before")
    assert export([f"{shell.folder}/run", "ply", "--times", "0.5", "--world", "--out", f"{shell.folder}/there"]) == 0
    scene = prepare(stored_config(shell.folder / "run"), lambda line: None).scene
    assert json.loads((shell.folder / "run/scene.json").read_text()) == json.loads(json.dumps(to_dict(scene)))
    (shell.folder / "before").rename(shell.folder / "after")
    return shell.folder


def test_it_is_exported_rendered_and_shown(moved: Path, capsys: pytest.CaptureFixture) -> None:
    run = str(moved / "run")
    assert export([run, "ply", "--times", "0.5", "--world", "--out", str(moved / "now")]) == 0
    name = "dnerf_mine.ply"
    assert (moved / "now" / name).read_bytes() == (moved / "there" / name).read_bytes()
    assert render([run, "--frames", "2", "--out", str(moved / "film")]) == 0
    page = (moved / "run/viewer.html").read_bytes()
    assert view([run]) == 0
    assert (moved / "run/viewer.html").read_bytes() == page, "the old one has the images"
    assert view([run, "--out", str(moved / "page.html")]) == 0
    said = capsys.readouterr().out
    assert f"{moved}/before: the run's data set is not there" in said and "viewer.html: kept" in said
    assert len((moved / "page.html").read_bytes()) < len(page)
    assert view([run, "--out", str(moved / "page.html"), "--data", str(moved / "after")]) == 0
    assert (moved / "page.html").read_bytes() == page


def test_what_needs_the_images_says_so(moved: Path, capsys: pytest.CaptureFixture) -> None:
    run = str(moved / "run")
    assert figures([run, "--out", str(moved / "figures")]) == 1
    err = capsys.readouterr().err
    missing = "expected the data set of the run, for its images, found nothing there; --data names its place"
    assert err == f"error: {moved}/before: {missing}\n"
    assert figures([run, "--out", str(moved / "figures"), "--data", str(moved / "after")]) == 0


def test_the_stored_scene_is_the_scene(moved: Path) -> None:
    found = read_scene(moved / "run/scene.json", moved / "before")
    read = open_run(moved / "run", lambda line: None, moved / "after").scene
    assert [getattr(found, name) for name in SCALARS] == [getattr(read, name) for name in SCALARS]
    for a, b in zip(found.train + found.test, read.train + read.test, strict=True):
        assert (a.name, a.time, a.image.shape, a.filmed_by) == (b.name, b.time, b.image.shape, b.filmed_by)
        assert (a.camera.world_to_cam == b.camera.world_to_cam).all() and a.camera.fx == b.camera.fx
    with pytest.raises(SceneError, match="before: expected the data set of the run, for its images"):
        np.asarray(found.train[0].image)
    broken = moved / "broken.json"
    broken.write_text('{"cameras": [{}]}')
    with pytest.raises(DataError, match="expected the scene of a run"):
        read_scene(broken, moved)


def test_the_command_goes_on_with_the_data_elsewhere_unless_they_differ(moved: Path) -> None:
    shell = Shell(moved)
    out, _ = shell(*COMMAND, f"scene.path={moved}/after")
    assert "train: already done" in out and f"path: {moved}/after" in (moved / "run/config.yaml").read_text()
    image = next((moved / "after/train").glob("*.png"))
    image.write_bytes(next((moved / "after/test").glob("*.png")).read_bytes())
    _, err = shell(*COMMAND, f"scene.path={moved}/after", status=1)
    assert "holds a run made from other data" in err
