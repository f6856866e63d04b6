"""The training loop: it learns, is deterministic, and continues after interruptions with the same bits."""

from __future__ import annotations

import signal
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from shell import FORKING
from tiny import TinyRun, fake_evaluate, tiny_config, tiny_scene, train_in_process, train_tiny

from pipeline.config.schema import AblationConfig, Config
from pipeline.config.train_schema import RegularizationConfig, ResolutionStep
from pipeline.data.training_views import TrainingViews
from pipeline.model.initialise import initialise
from pipeline.model.model import Model
from pipeline.runs.run_folder import CURVE_COLUMNS
from pipeline.training import checkpoint, finite_checks, loop, step
from pipeline.training.loop import train
from pipeline.training.objective import objective
from pipeline.training.objective.objective import Objective
from pipeline.training.state import start


def assert_same_state(a: Path, b: Path) -> None:
    """Equal checkpoints, bit for bit, except for the seconds."""
    one, two = (checkpoint.load(path / checkpoint.FILE_NAME) for path in (a, b))
    assert (one.iteration, one.step_count, one.best) == (two.iteration, two.step_count, two.best)
    moments = [
        {(n, i): m for n, pair in saved.shared_moments.items() for i, m in enumerate(pair)} for saved in (one, two)
    ]
    pairs = [
        (one.model.state(), two.model.state()),
        (one.best_model.state(), two.best_model.state()),
        moments,
        (one.moments[0], two.moments[0]),
        (one.moments[1], two.moments[1]),
        (one.statistics, two.statistics),
    ]
    for left, right in pairs:
        assert left.keys() == right.keys()
        assert all(torch.equal(left[name], right[name]) for name in left)
    assert np.array_equal(one.sampler["order"], two.sampler["order"])
    assert one.sampler["position"] == two.sampler["position"]
    assert one.sampler["generator"] == two.sampler["generator"]
    assert torch.equal(one.split_rng, two.split_rng)


def without_seconds(rows: list[dict]) -> list[dict]:
    return [{key: value for key, value in row.items() if key not in ("train_seconds", "cpu_seconds")} for row in rows]


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("uninterrupted")
    train_tiny(path)
    return path


def batch_losses(path: Path, scene, cfg) -> list[float]:
    """Mean loss of the first and the last ten iterations."""
    losses: list[float] = []
    original = Objective.backward

    def record(self, *arguments):
        view = original(self, *arguments)
        losses.append(view.loss)
        return view

    Objective.backward = record
    try:
        train_tiny(path, cfg, scene)
    finally:
        Objective.backward = original
    tenth = 10 * cfg.train.batch
    return [float(np.mean(losses[:tenth])), float(np.mean(losses[-tenth:]))]


@pytest.mark.parametrize(
    "static, ablation",
    [
        (False, AblationConfig()),
        (False, AblationConfig(rotation_4d=False)),
        (False, AblationConfig(fourier_order=0)),
        (False, AblationConfig(time_split=False)),
        (True, AblationConfig()),
    ],
)
def test_every_kind_of_model_learns(tmp_path, static: bool, ablation: AblationConfig) -> None:
    cfg = replace(tiny_config(120, eval_every=1000, checkpoint_every=1000), ablation=ablation)
    first, last = batch_losses(tmp_path, tiny_scene(static=static), cfg)
    assert last < 0.5 * first, "noise between batches is much less than half"


def test_logs_and_checkpoint_of_a_run(uninterrupted: Path) -> None:
    run = TinyRun(uninterrupted)
    assert [row["iteration"] for row in run.rows("error_vs_time.jsonl")] == [10, 20, 30, 40, 50, 60]
    assert set(run.rows("error_vs_time.jsonl")[0]) == set(CURVE_COLUMNS)
    for name in ("train_seconds", "cpu_seconds"):
        seconds = [row[name] for row in run.rows("error_vs_time.jsonl")]
        assert seconds == sorted(seconds) and seconds[0] > 0
    densified = [row for row in run.rows("log.jsonl") if row["event"] == "densify"]
    assert [row["iteration"] for row in densified] == [10, 20, 30, 40]
    assert any(row["cloned"] + row["split"] for row in densified), "densification must have an effect in this scene"
    saved = checkpoint.load(uninterrupted / checkpoint.FILE_NAME)
    assert saved.iteration == 60
    best = max(run.rows("error_vs_time.jsonl"), key=lambda row: row["psnr"])
    assert saved.best["psnr"] == best["psnr"] and saved.best["iteration"] == best["iteration"]
    assert fake_evaluate(saved.best_model, None)["psnr"] == best["psnr"]


def test_models_are_evaluated_before_they_are_densified(tmp_path) -> None:
    """Cloned and split Gaussians that no step has fitted would lower the PSNR; at the end they would stay unfitted."""
    train_tiny(tmp_path, tiny_config(30))
    run = TinyRun(tmp_path)
    densified = {row["iteration"]: row["n_gaussians"] for row in run.rows("log.jsonl") if row["event"] == "densify"}
    evaluated = {row["iteration"]: row["n_gaussians"] for row in run.rows("error_vs_time.jsonl")}
    assert set(densified) == {10, 20} and densified[10] != evaluated[10]
    assert (evaluated[20], evaluated[30]) == (densified[10], densified[20])
    assert len(checkpoint.load_model(tmp_path / checkpoint.FILE_NAME)) == evaluated[30]


def test_the_run_is_a_function_of_the_seed(uninterrupted: Path, tmp_path) -> None:
    train_tiny(tmp_path / "again")
    assert_same_state(uninterrupted, tmp_path / "again")
    train_tiny(tmp_path / "two_threads", replace(tiny_config(), threads=2))
    assert_same_state(uninterrupted, tmp_path / "two_threads")
    train_tiny(tmp_path / "other", replace(tiny_config(), seed=1))
    models = [checkpoint.load_model(p / checkpoint.FILE_NAME) for p in (uninterrupted, tmp_path / "other")]
    assert len(models[0]) != len(models[1]) or not torch.equal(*(m.parameters["mean"] for m in models))


def interrupted_in(iteration: int, path: Path, monkeypatch, cfg: Config | None = None) -> None:
    original = finite_checks.check_gradients

    def die(gradients, reached, *rest) -> None:
        original(gradients, reached, *rest)
        if reached == iteration:
            raise KeyboardInterrupt

    monkeypatch.setattr(finite_checks, "check_gradients", die)
    with pytest.raises(KeyboardInterrupt):
        train_tiny(path, cfg)
    monkeypatch.undo()


@pytest.mark.parametrize("stop", [14, 31])
def test_resuming_between_checkpoints(uninterrupted: Path, tmp_path, stop: int, monkeypatch) -> None:
    """Interrupted in iteration `stop`, after rows later than the last checkpoint were logged."""
    interrupted_in(stop, tmp_path, monkeypatch)
    train_tiny(tmp_path)
    assert_same_state(uninterrupted, tmp_path)
    for name in ("error_vs_time.jsonl", "log.jsonl"):
        assert without_seconds(TinyRun(tmp_path).rows(name)) == without_seconds(TinyRun(uninterrupted).rows(name))


def test_the_first_checkpoint_comes_by_time(uninterrupted: Path, tmp_path, monkeypatch) -> None:
    """After no second here: then at the first iteration, in the middle of every interval of the schedule."""
    monkeypatch.setattr(loop, "FIRST_SAVE_S", 0.0)
    cfg = tiny_config(checkpoint_every=1000)
    interrupted_in(23, tmp_path, monkeypatch, cfg)
    assert checkpoint.saved_iteration(tmp_path / checkpoint.FILE_NAME) == 1
    train_tiny(tmp_path, cfg)
    assert_same_state(uninterrupted, tmp_path)


def test_training_in_velocities_learns_resumes_and_ends_in_rotations(tmp_path, monkeypatch) -> None:
    """The disc of the scene moves. An interrupted training is the same to the bit."""
    cfg = tiny_config(120, eval_every=60, checkpoint_every=30, motion="tracks")
    first, last = batch_losses(tmp_path / "whole", tiny_scene(), cfg)
    assert last < 0.5 * first, "noise between batches is much less than half"
    interrupted_in(75, tmp_path / "parts", monkeypatch, cfg)
    model = train_tiny(tmp_path / "parts", cfg).model
    assert_same_state(tmp_path / "whole", tmp_path / "parts")
    trained = checkpoint.load(tmp_path / "parts" / checkpoint.FILE_NAME).model
    assert (trained.kind.motion, model.kind.motion) == ("velocity", "full")
    assert trained.parameters["velocity"].norm(dim=1).max() > 0.1  # the disc moves by 1.2 units in the duration


@pytest.mark.usefixtures("small_backgrounds")
@pytest.mark.parametrize("background_model", ["none", "sphere", "envmap"])
def test_resuming_after_sigkill(tmp_path, background_model: str) -> None:
    """A child process is killed at a random time; this process continues from its files."""
    iterations, delay = 150, float(np.random.default_rng().uniform(0, 0.25))
    file = tmp_path / "killed" / checkpoint.FILE_NAME
    process = FORKING.Process(target=train_in_process, args=(tmp_path / "killed", iterations, background_model))
    process.start()
    while process.is_alive() and not file.exists():
        time.sleep(0.002)
    time.sleep(delay)
    process.kill()
    process.join()
    assert process.exitcode in (-signal.SIGKILL, 0)
    train_tiny(tmp_path / "killed", tiny_config(iterations, background_model))
    train_tiny(tmp_path / "whole", tiny_config(iterations, background_model))
    assert_same_state(tmp_path / "whole", tmp_path / "killed")
    for name in ("error_vs_time.jsonl", "log.jsonl"):
        killed, whole = (without_seconds(TinyRun(tmp_path / run).rows(name)) for run in ("killed", "whole"))
        assert killed == whole, f"killed {delay} s after the first checkpoint"


def test_resuming_a_finished_run_changes_nothing(uninterrupted: Path) -> None:
    before = (uninterrupted / checkpoint.FILE_NAME).read_bytes()
    result = train_tiny(uninterrupted)
    assert result.iteration == 60
    assert (uninterrupted / checkpoint.FILE_NAME).read_bytes() == before


def test_not_resuming_starts_over(tmp_path) -> None:
    train_tiny(tmp_path, tiny_config(20))
    result = train_tiny(tmp_path, replace(tiny_config(10), resume=False))
    assert result.iteration == 10
    assert [row["iteration"] for row in TinyRun(tmp_path).rows("error_vs_time.jsonl")] == [10]


def test_a_checkpoint_of_another_run_is_refused(tmp_path) -> None:
    train_tiny(tmp_path, tiny_config(10))
    with pytest.raises(ValueError, match="expected a checkpoint of seed 1"):
        train_tiny(tmp_path, replace(tiny_config(20), seed=1))


@pytest.mark.parametrize(
    "keys",
    [
        {"motion": "tracks", "regularization": RegularizationConfig(opacity=1.0)},
        {"optimiser": "sparse_adam"},
        {"batch": 1},
        {"resolution_steps": [ResolutionStep(0.5, 0.5)]},
        {"resolution_scale": 0.5},
        {"regularization": RegularizationConfig(rigid_released=1.0)},
    ],
)
def test_every_option_runs(tmp_path, keys: dict) -> None:
    assert train_tiny(tmp_path, tiny_config(12, **keys)).iteration == 12


def test_time_budget_ends_the_run_with_an_evaluation_and_a_checkpoint(tmp_path) -> None:
    result = train_tiny(tmp_path, tiny_config(100_000, time_budget_s=0.3, eval_every=10**6, checkpoint_every=10**6))
    assert result.iteration < 100_000 and result.spent.seconds >= 0.3
    assert checkpoint.load(tmp_path / checkpoint.FILE_NAME).iteration == result.iteration
    assert [row["iteration"] for row in TinyRun(tmp_path).rows("error_vs_time.jsonl")] == [result.iteration]


def test_evaluation_is_not_training_time(tmp_path) -> None:
    def slow(model: Model, progress) -> dict:
        time.sleep(0.5)
        return fake_evaluate(model, progress)

    cfg, scene = tiny_config(4, eval_every=1), tiny_scene()
    model = initialise(scene, cfg, np.random.default_rng(0))
    started = time.perf_counter()
    result = train(model, scene, cfg, TinyRun(tmp_path), slow)
    assert time.perf_counter() - started > 2 > 1.9 > result.spent.seconds


def test_the_log_counts_gaussians_before_densification(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(loop, "REPORT_EVERY", 1)
    monkeypatch.setattr(loop, "LOG_EVERY", 1)
    train_tiny(tmp_path)
    rows = TinyRun(tmp_path).rows("log.jsonl")
    after, total = {row["iteration"]: row["n_gaussians"] for row in rows if row["event"] == "densify"}, 200
    assert len(set(after.values())) > 1, "densification changes the number of Gaussians"
    for row in (row for row in rows if row["event"] == "train"):
        assert row["n_alive"] <= row["n_gaussians"] == total
        total = after.get(row["iteration"], total)


def test_pixels_outside_a_mask_have_no_gradient(tmp_path) -> None:
    """Not even those within SSIM's window of valid pixels: Gaussians seen only there stay as they are."""
    scene, cfg = tiny_scene(2), tiny_config(4)
    mask = np.zeros((32, 32), bool)
    mask[:, 16:] = True
    scene = replace(scene, train=tuple(replace(view, mask=mask) for view in scene.train))
    model = initialise(scene, cfg, np.random.default_rng(0))
    state = start(model, scene, cfg, TinyRun(tmp_path))
    phase = state.begin_iteration(scene, cfg)
    found = []
    original = objective.backward

    def record(rasterizer, model, rendered, gradient, *rest):
        found.append(gradient.image.clone())
        return original(rasterizer, model, rendered, gradient, *rest)

    objective.backward = record
    try:
        drawn = step.draw_batch(state, TrainingViews(scene.train), phase, scene, cfg)
        step.render_batch(state, drawn, phase, Objective(scene, cfg, 1), scene, cfg)
    finally:
        objective.backward = original
    for gradient in found:
        assert not gradient[:, :, :16].any() and gradient[:, :, 16:].any()
