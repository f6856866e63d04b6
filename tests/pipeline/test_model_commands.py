"""Commands on a trained model: export, evaluate, render and figures, on one run of seconds."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from shell import TINY, Shell

from datasets.canonical import Canonical
from pipeline.evaluate import main as evaluate
from pipeline.evaluate import name_of
from pipeline.export.__main__ import main as export
from pipeline.export.formats import FORMATS
from pipeline.figures.__main__ import main as figures
from pipeline.model.ply import load_ply, save_ply
from pipeline.model.transformed import in_canonical
from pipeline.render import main as render
from pipeline.report.__main__ import main as report
from pipeline.training.checkpoint import load_model
from pipeline.view.__main__ import main as view

SCENE = TINY[:1] + TINY[2:]  # without the schedule


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    shell = Shell(tmp_path_factory.mktemp("commands"))
    _, err = shell(*TINY, "out=run", f"scene.cache={shell.folder}/cache")
    assert err == ""
    return shell.folder / "run"


def test_every_format_is_written(run: Path, capsys: pytest.CaptureFixture) -> None:
    assert export([str(run), *FORMATS, "--times", "0,1"]) == 0
    said = capsys.readouterr().out
    names = {path.name for path in (run / "exports").iterdir()}
    assert names == {f"synthetic_wheel_000{i}.{name}" for i in (0, 1) for name in ("ply", "splat", "spz", "glb")} | {
        f"synthetic_wheel.{name}" for name in ("ftgs.ply", "splatv", "4dgs", "pth")
    }
    assert all(form.loses in said for form in FORMATS.values())
    assert load_ply(run / "exports/synthetic_wheel_0000.ply").kind.motion == "static"


def test_help_says_what_each_format_loses(capsys: pytest.CaptureFixture) -> None:
    with pytest.raises(SystemExit):
        export(["--help"])
    said = " ".join(capsys.readouterr().out.split())
    assert all(f"{name} {form.holds}; {form.read_by} loses {form.loses}" in said for name, form in FORMATS.items())


@pytest.mark.parametrize(
    "arguments, error",
    [
        (["ply", "--times", "2"], "--times: expected times in 0 to 1, found 2"),
        (["ply", "--duration", "2"], "run: expected a file with --start or --duration"),
    ],
)
def test_wrong_options_end_in_a_line(
    run: Path, capsys: pytest.CaptureFixture, arguments: list[str], error: str
) -> None:
    assert export([str(run), *arguments]) == 1
    assert error in capsys.readouterr().err


def test_a_model_in_a_file_is_exported_and_evaluated(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """Of the released program's layout, which has all of the model: the same numbers as the run's own evaluation."""
    assert export([str(run), "pth", "--out", str(tmp_path)]) == 0
    file = tmp_path / "synthetic_wheel.pth"
    assert export([str(file), "ply", "--times", "0.5"]) == 0
    assert load_ply(tmp_path / "exports/synthetic_wheel.ply").kind.motion == "static"
    assert evaluate([str(file), *SCENE, f"scene.cache={run.parent}/cache", "--out", str(tmp_path / "found")]) == 0
    found, own = (json.loads((folder / "metrics.json").read_text()) for folder in (tmp_path / "found", run))
    for name in ("psnr", "ssim", "flow_error", "depth_error_median"):
        assert found["final"][name] == own["final"][name], name
    assert found["n_gaussians"] == len(load_model(run / "checkpoint.safetensors"))
    assert sorted(path.name for path in (tmp_path / "found").iterdir()) == ["metrics.json", "per_image.csv", "renders"]
    capsys.readouterr()
    assert evaluate([str(run / "metrics.json"), *SCENE]) == 1
    assert "expected a file of a model (.safetensors, .ply, .pth), found .json" in capsys.readouterr().err
    assert evaluate([str(file), "scene=synthetic/weel"]) == 1
    assert "error: scene=synthetic/weel: no such option" in capsys.readouterr().err


@pytest.mark.parametrize("times", ["0.5", "0,1"])
def test_the_exported_file_itself_is_not_replaced(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture, times: str
) -> None:
    file = tmp_path / "run.ply"
    shutil.copy(run / "init.ply", file)
    before = file.read_bytes()
    assert export([str(file), "ply", "--times", times, "--out", str(tmp_path)]) == 1
    assert "run.ply: would be replaced by its export; expected another folder" in capsys.readouterr().err
    assert file.read_bytes() == before


def test_a_path_of_ones_own_is_rendered(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    pose = [[1, 0, 0, 0], [0, 0, -1, -4.0], [0, 1, 0, 0], [0, 0, 0, 1]]
    file = tmp_path / "poses.json"
    file.write_text(json.dumps({"w": 40, "h": 30, "frames": [{"transform_matrix": pose, "time": 0.5}] * 2}))
    out = tmp_path / "out"
    out.mkdir()
    for name in ("0000_left.png", "0007_render.png"):  # somebody's, and of a longer path
        (out / name).write_bytes(b"")
    assert render([str(run), "--path", str(file), "--out", str(out)]) == 0
    kinds = ("render", "depth", "flow")
    assert {path.name for path in out.iterdir()} == {"0000_left.png"} | {f"{kind}.mp4" for kind in kinds} | {
        f"{number:04d}_{kind}.png" for number in (0, 1) for kind in kinds
    }
    first, second = (np.asarray(Image.open(out / f"000{i}_render.png")) for i in (0, 1))
    assert first.shape == (30, 40, 3) and np.array_equal(first, second), "one pose, one time"
    assert render([str(run), "--path", str(file), "--times", "0,0.5,1"]) == 1
    assert "--times: expected 2, one a frame of the path, found 3" in capsys.readouterr().err
    assert render([str(run), "--frames", "3", "--out", str(tmp_path / "orbit")]) == 0
    assert (tmp_path / "orbit/0002_flow.png").exists()


def test_figures_are_in_the_run_folder(run: Path) -> None:
    assert figures([str(run)]) == 0
    index = json.loads((run / "figures/figures.json").read_text())
    assert [row["file"] for row in index] == [
        "flow.png", "time_maps.png", "lifetimes.png", "slices.png", "growth.png", "film.png",
    ]  # fmt: skip
    page = (run / "figures/figures.md").read_text()
    assert all(row["seen"] in page and (run / "figures" / row["file"]).exists() for row in index)


def test_commands_on_a_run_with_shared_motion(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    shell = Shell(tmp_path)
    cache = f"scene.cache={tmp_path}/cache"
    size = [override for override in TINY if override != "train=smoke"]
    _, err = shell(*size, "train=fast", "capture=shared", "train.iterations=60", "train.select=false",
                   "train.init_points=300", "out=run", cache)  # fmt: skip
    assert err == ""
    run = tmp_path / "run"
    kind = json.loads((run / "metrics.json").read_text())["kind"]
    assert (kind["motion"], kind["trajectories"]) == ("velocity", 32)
    capsys.readouterr()
    assert export([str(run), "ply", "4dgs", "ftgs.ply", "splatv", "--times", "0,1"]) == 0
    said = capsys.readouterr().out
    assert all(f"{name}: " in said for name in ("4dgs", "ftgs.ply", "splatv"))
    assert said.count("Gaussians on shared trajectories became ") == 3 and "off by at most" in said
    assert export([str(run), "pth"]) == 1
    assert "error: pth: expected a model without shared trajectories" in capsys.readouterr().err
    assert evaluate([str(run), *SCENE, cache, "--out", str(tmp_path / "found")]) == 0
    found, own = (json.loads((folder / "metrics.json").read_text()) for folder in (tmp_path / "found", run))
    assert found["kind"] == kind
    for name in ("psnr", "ssim", "flow_error", "depth_error_median"):
        assert found["final"][name] == own["final"][name], name
    assert render([str(run), "--frames", "3", "--out", str(tmp_path / "orbit")]) == 0
    assert (tmp_path / "orbit/0002_flow.png").exists()
    assert figures([str(run)]) == 0
    assert (run / "figures/paths.png").exists()


def test_frames_of_an_earlier_export_do_not_stay(run: Path, tmp_path: Path) -> None:
    assert export([str(run), "splat", "--times", "0,0.2,0.4,1", "--out", str(tmp_path)]) == 0
    (tmp_path / "synthetic_wheel_0000.png").write_text("kept")
    assert export([str(run), "splat", "--times", "0,1", "--out", str(tmp_path)]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {
        "synthetic_wheel_0000.splat", "synthetic_wheel_0001.splat", "synthetic_wheel_0000.png"
    }  # fmt: skip


@pytest.mark.parametrize(
    "main, arguments, error",
    [
        (export, ["ply", "--duration", "0"], "--duration: expected a positive time, found 0"),
        (export, ["ply", "--times", "abc"], "expected times such as 0,0.5,1, found abc"),
        (render, ["--times", "abc"], "expected times such as 0.5, 0:1 or 0,0.5,1, found abc"),
        (render, ["--frames", "0"], "--frames: expected at least 1, found 0"),
        (export, ["pth", "--times", "0"], "--times: expected a format of one moment, found pth"),
        (view, ["--live", "--out", "x.html"], "--out: expected no --live beside it, found x.html"),
        (report, ["--site", "x", "--latex"], "--latex: expected no --site beside it, found x"),
        (render, ["--frames", "3", "--path", "p.json"], "--frames: expected --path orbit, found --path p.json"),
    ],
)
def test_wrong_values_end_in_a_line(capsys: pytest.CaptureFixture, main, arguments: list[str], error: str) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["run", *arguments])
    assert stopped.value.code == 2 and error in capsys.readouterr().err


def test_a_missing_model_is_named_before_the_scene_is_read(capsys: pytest.CaptureFixture) -> None:
    assert evaluate(["nowhere.ply", "scene=dnerf", "scene.path=nowhere_else"]) == 1
    assert "nowhere.ply: expected a run folder or a file of a model, found none" in capsys.readouterr().err


def test_results_of_two_runs_have_two_folders(tmp_path: Path) -> None:
    for ablation in ("full", "no_4drot"):
        (tmp_path / ablation / "fast" / "seed0").mkdir(parents=True)
    assert name_of(tmp_path / "full/fast/seed0") == "full_fast_seed0"
    assert name_of(tmp_path / "no_4drot/fast/seed0") == "no_4drot_fast_seed0"
    assert name_of(tmp_path / "full/fast/seed0/checkpoint.safetensors") == "full_fast_seed0_checkpoint"
    assert name_of(Path("/model.ply")) == "model"


def test_a_model_is_read_in_its_own_run_s_coordinates(run: Path, tmp_path: Path) -> None:
    """Those of another choice of training cameras: the file is moved, scaled and slower, and its canonical.json says
    so. Images are the same up to float32."""
    own = Canonical((0.3, -0.2, 0.1), 1.3, 0.1, 0.7)
    save_ply(tmp_path / "model.ply", in_canonical(load_model(run / "checkpoint.safetensors"), own))
    (tmp_path / "canonical.json").write_text(json.dumps(own.to_dict()))
    arguments = [str(tmp_path / "model.ply"), *SCENE, f"scene.cache={run.parent}/cache", "--out", str(tmp_path / "x")]
    assert evaluate(arguments) == 0
    found, trained = (json.loads((folder / "metrics.json").read_text())["final"] for folder in (tmp_path / "x", run))
    assert found["psnr"] == pytest.approx(trained["psnr"], abs=1e-2)
    (tmp_path / "canonical.json").write_text('{"scale": 1}')
    assert evaluate(arguments) == 1


def test_runs_over_other_backgrounds_are_not_shown_side_by_side(run: Path, capsys: pytest.CaptureFixture) -> None:
    white = run.parent / "white"
    shell = Shell(run.parent)
    shell(*TINY, "out=white", f"scene.cache={run.parent}/cache", "scene.background=white")
    assert view([str(run), str(white), "--out", str(run.parent / "both.html")]) == 1
    assert "with the cameras, times, background and near plane of" in capsys.readouterr().err
    assert view([str(run), str(run), "--out", str(run.parent / "both.html")]) == 0


def test_a_path_with_some_times_is_refused(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    pose = [[1, 0, 0, 0], [0, 0, -1, -4], [0, 1, 0, 0], [0, 0, 0, 1]]
    frames = [{"transform_matrix": pose, "time": 0.5}, {"transform_matrix": pose}]
    (tmp_path / "path.json").write_text(json.dumps({"camera_angle_x": 0.7, "w": 16, "h": 16, "frames": frames}))
    assert render([str(run), "--path", str(tmp_path / "path.json"), "--out", str(tmp_path / "out")]) == 1
    assert "path.json: expected a time in every frame or in none, found none in frames[1]" in capsys.readouterr().err
