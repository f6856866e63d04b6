"""The whole chain by its command line: what a run leaves, that it is not made twice, that it survives a kill."""

from __future__ import annotations

import csv
import json
import re
import threading
import time
from pathlib import Path
from urllib.request import urlopen

import pytest
import yaml
from shell import TINY, Shell, result

from datasets.files.claim import HIDDEN
from pipeline.view.live.followed_run import serve_run
from pipeline.view.live.server import Address


@pytest.fixture(scope="module")
def shell(tmp_path_factory) -> Shell:
    return Shell(tmp_path_factory.mktemp("pipeline"))


@pytest.fixture(scope="module")
def finished(shell: Shell) -> Path:
    """The folder of a run that ended well."""
    out, err = shell.fresh(*TINY)
    assert err == "" and "PSNR" in out and "python -m pipeline.report results/runs" in out
    return shell.folder / "results/runs/synthetic/wheel/full/smoke/seed0"


@pytest.fixture(scope="module")
def run_argument(shell: Shell, finished: Path) -> str:
    """As a user would type it."""
    return str(finished.relative_to(shell.folder))


def read_csv(path: Path) -> list[dict[str, str]]:
    with open(path) as file:
        return list(csv.DictReader(file))


def test_a_run_folder_is_complete(finished: Path) -> None:
    assert {path.name for path in finished.iterdir() if not path.name.startswith(HIDDEN)} == {
        "config.yaml",
        "scene.json",
        "environment.json",
        "stages.json",
        "log.jsonl",
        "init.ply",
        "checkpoint.safetensors",
        "error_vs_time.csv",
        "metrics.json",
        "per_image.csv",
        "renders",
        "viewer.html",
    }
    # 3 test views: render, truth, difference, what moves, depth and flow
    assert len(list((finished / "renders").glob("*.png"))) == 18


def test_metrics(finished: Path) -> None:
    metrics = json.loads((finished / "metrics.json").read_text())
    for model in ("final", "best_on_test"):
        assert {
            "psnr",
            "ssim",
            "ms_ssim",
            "dssim1",
            "dssim2",
            "lpips_alex",
            "lpips_vgg",
            "lpips_note",
            "fps_raster",
            "fps_render",
        } <= set(metrics[model])
    assert metrics["best_on_test"]["psnr"] >= metrics["final"]["psnr"] - 1e-4  # chosen by float32 sums in another order
    assert {
        "n_gaussians",
        "n_alive_mean",
        "train_seconds",
        "peak_rss_mb",
        "model_mb",
        "model_with_optimiser_mb",
        "iterations",
        "scene",
        "model",
        "recipe",
        "seed",
    } <= set(metrics)
    assert (metrics["scene"], metrics["model"], metrics["recipe"], metrics["seed"]) == (
        "synthetic/wheel",
        "full",
        "smoke",
        0,
    )
    assert metrics["iterations"] == 60
    # 161 float32 a Gaussian of the full model: mean 4, scale 4, rotations 8, opacity 1, colour 48 · 3.
    assert metrics["model_mb"] == pytest.approx(metrics["n_gaussians"] * 161 * 4 / 1e6)
    assert metrics["model_with_optimiser_mb"] == pytest.approx(3 * metrics["model_mb"])


def test_time_varying_colour_without_a_gain_is_left_out_of_the_model(tmp_path: Path) -> None:
    """Fourier orders that begin after the last iteration give no gain. Enough views and iterations for more than a
    blur, below which nothing is decided."""
    shell, learns = Shell(tmp_path), ("train=short", "scene.train_views=40", "train.iterations=320")
    keys = "train.init_points=2000", "train.select=true", "train.orders_at=[20,40,60,4000,4000]"
    arguments = (*TINY, *learns, *keys, "evaluate.videos=false", "out=run")
    out, _ = shell(*arguments)
    assert "settle: without time-varying colour, 150 iterations; 30 training views, 10 validation views" in out
    assert "settle: time-varying colour left out" in out and "(+0.00 ± 0.00;" in out
    folder = tmp_path / "run"
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["decided"] == {"fourier_order": 0} and metrics["compared"]["time_colour"]["gain"] == 0
    assert metrics["kind"] == {"motion": "full", "fourier_order": 0, "sh_degree": 3, "trajectories": 0}
    # 65 float32 a Gaussian: mean 4, scale 4, rotations 8, opacity 1, colour 16 · 3.
    assert metrics["model_mb"] == pytest.approx(metrics["n_gaussians"] * 65 * 4 / 1e6)
    first = float(read_csv(folder / "error_vs_time.csv")[0]["train_seconds"])
    seconds = metrics["compared"]["time_colour"]["seconds"]
    assert metrics["train_seconds"] > first > seconds > 0, "its seconds are training's"
    assert metrics["train_cpu_seconds"] > metrics["compared"]["time_colour"]["cpu_seconds"] > 0
    again, _ = shell(*arguments)
    assert all(f"{name}: already done" in again for name in ("settle", "init", "train", "evaluate"))


def test_per_image_rows_average_to_the_metrics(finished: Path) -> None:
    rows = [row for row in read_csv(finished / "per_image.csv") if row["model"] == "final"]
    assert len(rows) == 3
    metrics = json.loads((finished / "metrics.json").read_text())
    assert sum(float(row["psnr"]) for row in rows) / 3 == pytest.approx(metrics["final"]["psnr"])


def test_the_curve_ends_with_the_run(finished: Path) -> None:
    rows = read_csv(finished / "error_vs_time.csv")
    assert [int(row["iteration"]) for row in rows] == [20, 40, 60]
    seconds = [float(row["train_seconds"]) for row in rows]
    assert seconds == sorted(seconds)
    metrics = json.loads((finished / "metrics.json").read_text())
    # The two evaluations add up the pixels in different orders.
    assert float(rows[-1]["psnr"]) == pytest.approx(metrics["final"]["psnr"], abs=1e-4)


def test_what_a_run_was_made_with(finished: Path) -> None:
    provenance = json.loads((finished / "environment.json").read_text())
    assert provenance["command"].startswith("python -m pipeline scene=synthetic/wheel train=smoke")
    assert provenance["versions"]["torch"] and provenance["machine"] and provenance["git_commit"]
    config = yaml.safe_load((finished / "config.yaml").read_text())
    assert config["out"] == "results/runs/synthetic/wheel/full/smoke/seed0" and config["train"]["iterations"] == 60


def test_nothing_else_is_written(finished: Path, shell: Shell) -> None:
    assert [path.name for path in shell.folder.iterdir()] == ["results"]
    assert sorted(path.name for path in (shell.folder / "results").iterdir()) == ["cache", "runs"]


def test_doing_it_again_does_nothing(finished: Path, shell: Shell) -> None:
    kept = ("init.ply", "checkpoint.safetensors", "metrics.json", "log.jsonl", "environment.json", "stages.json")
    before = {name: (finished / name).stat().st_mtime_ns for name in kept}
    out, _ = shell(*TINY)
    assert all(f"{stage}: already done" in out for stage in ("init", "train", "evaluate"))
    assert {name: (finished / name).stat().st_mtime_ns for name in kept} == before


def test_other_settings_of_the_evaluation_repeat_only_that(finished: Path, shell: Shell) -> None:
    trained_by = (finished / "environment.json").read_text()
    out, _ = shell(*TINY, "evaluate.renders=0", "evaluate.best_on_test=false")
    assert "train: already done" in out and "evaluate: already done" not in out
    assert (finished / "environment.json").read_text() == trained_by
    shell(*TINY)  # as it was, for the other tests


def test_another_run_in_the_same_folder_is_refused(finished: Path, shell: Shell) -> None:
    _, err = shell(*TINY, "train.batch=1", status=1)
    assert err.count("\n") == 1
    assert "holds another run, with train.batch=2 but this command has 1" in err and "resume=false" in err


def test_other_data_in_the_same_folder_is_refused(finished: Path, shell: Shell) -> None:
    cached = next((shell.folder / "results/cache").rglob("train/*.png"))
    before = cached.read_bytes()
    other = next(path for path in sorted(cached.parent.glob("*.png")) if path.read_bytes() != before)
    cached.write_bytes(other.read_bytes())
    try:
        _, err = shell(*TINY, status=1)
    finally:
        cached.write_bytes(before)
    assert err.count("\n") == 1 and "made from other data" in err


def test_killed_and_started_again_it_ends_the_same(finished: Path, shell: Shell) -> None:
    folder = shell.folder / "killed"
    command = shell.start(*TINY, "out=killed")
    while not (folder / "checkpoint.safetensors").exists():
        assert command.is_running(), command.wait()
        time.sleep(0.01)
    command.kill()
    shell(*TINY, "out=killed")
    assert result(folder) == result(finished)
    curves = [
        [(row["iteration"], row["psnr"]) for row in read_csv(run / "error_vs_time.csv")] for run in (folder, finished)
    ]
    assert curves[0] == curves[1]


def test_a_sweep_side_by_side_goes_on_after_a_failure(shell: Shell) -> None:
    side_by_side = ("launcher=joblib", "hydra.launcher.n_jobs=2", "seed=-1,1,2")
    out, err = shell.fresh("-m", *TINY, *side_by_side, "train.iterations=20", status=1)
    assert err.startswith(
        "error: seed: expected in 0..9223372036854775807, found -1 [python -m pipeline scene=synthetic"
    )
    assert err.count("\n") == 1
    first_line, last_line = out.splitlines()  # a line a run, and nothing of the stages
    assert re.match(r"2/3 runs, \d+ min left  .*PSNR", first_line)
    assert re.match(r"3/3 runs in \d+ min  .*PSNR", last_line)
    runs = [shell.folder / f"results/runs/synthetic/wheel/full/smoke/seed{seed}" for seed in (1, 2)]
    first, second = (json.loads((run / "metrics.json").read_text()) for run in runs)
    assert first["final"]["psnr"] != second["final"]["psnr"]
    command = json.loads((runs[0] / "environment.json").read_text())["command"]
    assert "scene=synthetic/wheel" in command and "seed=1" in command


def test_compression_of_a_finished_run(shell: Shell, run_argument: str) -> None:
    out, err = shell(run_argument, module="pipeline.studies.compression")
    assert err == "" and "PSNR against size and speed" in out
    assert {path.name for path in (shell.folder / "results/compression").iterdir()} == {
        "compression.md",
        "compression.safetensors",
    }


def test_viewer_of_finished_runs(shell: Shell, run_argument: str) -> None:
    out, err = shell(run_argument, run_argument, "--out", "two.html", module="pipeline.view")
    assert err == "" and out.endswith("MB; open it in a browser\n")
    text = (shell.folder / "two.html").read_text()
    assert 'id="model-0"' in text and 'id="model-1"' in text
    (shell.folder / run_argument / "viewer.html").unlink()
    out, _ = shell(*TINY)  # deleted, so it is not done
    assert "evaluate: already done" in out and "page: already done" not in out
    assert 'id="model-1"' not in (shell.folder / run_argument / "viewer.html").read_text()


def test_live_view_of_a_command(shell: Shell, finished: Path) -> None:
    command = shell.start(*TINY, "out=live", "view=true", "view_at=127.0.0.1:0")
    while "live view: " not in command.said():
        assert command.is_running(), command.wait()
        time.sleep(0.01)
    url = command.said().split("live view: ")[1].split()[0]
    with urlopen(f"{url}model?after=-1") as answer:
        assert len(answer.read()) > 1000
    status, _, err = command.wait()
    assert (status, err) == (0, "") and result(shell.folder / "live") == result(finished)


def test_live_view_of_another_process(shell: Shell, finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(shell.folder)
    said: list[str] = []
    stop = threading.Event()
    serving = threading.Thread(target=serve_run, args=(finished, Address("127.0.0.1", 0), said.append, stop))
    serving.start()
    while not any(line.startswith("live view: ") for line in said):
        assert serving.is_alive()
        time.sleep(0.01)
    with urlopen(f"{said[-1].split()[2]}model?after=-1") as answer:
        message = answer.read()
    stop.set()
    serving.join()
    assert json.loads(message[4 : 4 + int.from_bytes(message[:4], "little")])["iteration"] == 60


@pytest.mark.parametrize("module", ["pipeline.studies.compression", "pipeline.view"])
def test_a_folder_without_a_run_is_refused_in_one_line(shell: Shell, module: str) -> None:
    out, err = shell("nowhere", module=module, status=1)
    assert out == "" and err.startswith("error: nowhere: expected a ") and err.count("\n") == 1
