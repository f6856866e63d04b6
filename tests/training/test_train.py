"""The loop: it learns, is a function of its seed, survives being killed, and stops at what is not a number."""

from __future__ import annotations

import signal
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from shell import FORKING
from tiny import TinyRun, fake_evaluate, tiny_config, tiny_scene, train_alone, train_tiny

from pipeline.config.schema import AblationConfig
from pipeline.config.train_schema import ResolutionStep
from pipeline.data.training_views import TrainingViews, area_weights, target_of
from pipeline.model.initialise import initialise
from pipeline.model.model import Model
from pipeline.training import checkpoint, finite_checks, loop, step
from pipeline.training.loop import train


def assert_same_state(a: Path, b: Path) -> None:
    """Bit for bit everything but the seconds."""
    one, two = (checkpoint.load(path / checkpoint.FILE_NAME) for path in (a, b))
    assert (one.iteration, one.step_count, one.best) == (two.iteration, two.step_count, two.best)
    moments = [dict(enumerate(saved.environment_moments or ())) for saved in (one, two)]
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
    assert torch.equal(one.split_generator, two.split_generator)


def without_seconds(rows: list[dict]) -> list[dict]:
    return [{key: value for key, value in row.items() if key != "train_seconds"} for row in rows]


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("uninterrupted")
    train_tiny(path)
    return path


def batch_losses(path: Path, scene, cfg) -> list[float]:
    """Mean loss of the first and the last ten iterations."""
    losses: list[float] = []
    original = step.Batch.backward

    def record(self, target, gradients, generator=None):
        view = original(self, target, gradients, generator)
        losses.append(view.loss)
        return view

    step.Batch.backward = record
    try:
        train_tiny(path, cfg, scene)
    finally:
        step.Batch.backward = original
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
    assert last < 0.5 * first, "half is far from what noise between batches does"


def test_what_a_run_leaves_behind(uninterrupted: Path) -> None:
    run = TinyRun(uninterrupted)
    assert [row["iteration"] for row in run.rows("error_vs_time.jsonl")] == [10, 20, 30, 40, 50, 60]
    assert set(run.rows("error_vs_time.jsonl")[0]) == {
        "train_seconds",
        "iteration",
        "psnr",
        "ssim",
        "test_loss",
        "n_gaussians",
    }
    seconds = [row["train_seconds"] for row in run.rows("error_vs_time.jsonl")]
    assert seconds == sorted(seconds) and seconds[0] > 0
    densified = [row for row in run.rows("log.jsonl") if row["event"] == "densify"]
    assert [row["iteration"] for row in densified] == [10, 20, 30, 40]
    assert any(row["cloned"] + row["split"] for row in densified), "the scene must exercise densification"
    saved = checkpoint.load(uninterrupted / checkpoint.FILE_NAME)
    assert saved.iteration == 60
    best = max(run.rows("error_vs_time.jsonl"), key=lambda row: row["psnr"])
    assert saved.best["psnr"] == best["psnr"] and saved.best["iteration"] == best["iteration"]
    assert fake_evaluate(saved.best_model, None)["psnr"] == best["psnr"], "best_model is the model of that moment"


def test_the_same_seed_gives_the_same_run(uninterrupted: Path, tmp_path) -> None:
    train_tiny(tmp_path / "again")
    assert_same_state(uninterrupted, tmp_path / "again")
    train_tiny(tmp_path / "two_threads", replace(tiny_config(), threads=2))
    assert_same_state(uninterrupted, tmp_path / "two_threads")
    train_tiny(tmp_path / "other", replace(tiny_config(), seed=1))
    models = [checkpoint.load_model(p / checkpoint.FILE_NAME) for p in (uninterrupted, tmp_path / "other")]
    assert len(models[0]) != len(models[1]) or not torch.equal(*(m.parameters["mean"] for m in models))


@pytest.mark.parametrize("stop", [14, 31])
def test_resuming_after_a_stop_at_any_iteration(uninterrupted: Path, tmp_path, stop: int, monkeypatch) -> None:
    """Dies in iteration `stop`, between checkpoints, after rows later than the checkpoint were logged."""
    original = finite_checks.check_gradients

    def die(gradients, iteration, *rest) -> None:
        original(gradients, iteration, *rest)
        if iteration == stop:
            raise KeyboardInterrupt

    monkeypatch.setattr(finite_checks, "check_gradients", die)
    with pytest.raises(KeyboardInterrupt):
        train_tiny(tmp_path)
    monkeypatch.undo()
    train_tiny(tmp_path)
    assert_same_state(uninterrupted, tmp_path)
    for name in ("error_vs_time.jsonl", "log.jsonl"):
        assert without_seconds(TinyRun(tmp_path).rows(name)) == without_seconds(TinyRun(uninterrupted).rows(name))


@pytest.mark.parametrize("background", ["none", "sphere", "envmap"])
def test_kill_9_at_a_random_moment(tmp_path, background: str) -> None:
    """The real thing: another process is sent SIGKILL, then this one goes on from what it left."""
    iterations, delay = 300, float(np.random.default_rng().uniform(0, 0.5))
    file = tmp_path / "killed" / checkpoint.FILE_NAME
    process = FORKING.Process(target=train_alone, args=(tmp_path / "killed", iterations, background))
    process.start()
    while process.is_alive() and not file.exists():
        time.sleep(0.002)
    time.sleep(delay)
    process.kill()
    process.join()
    assert process.exitcode in (-signal.SIGKILL, 0)
    train_tiny(tmp_path / "killed", tiny_config(iterations, background))
    train_tiny(tmp_path / "whole", tiny_config(iterations, background))
    assert_same_state(tmp_path / "whole", tmp_path / "killed")
    for name in ("error_vs_time.jsonl", "log.jsonl"):
        killed, whole = (without_seconds(TinyRun(tmp_path / run).rows(name)) for run in ("killed", "whole"))
        assert killed == whole, f"killed {delay} s after the first checkpoint"


def test_resuming_a_finished_run_does_nothing(uninterrupted: Path) -> None:
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


def test_moments_can_be_dropped_at_the_end_but_then_not_continued(tmp_path) -> None:
    train_tiny(tmp_path, tiny_config(10, checkpoint_keep_moments=False))
    train_tiny(tmp_path, tiny_config(10, checkpoint_keep_moments=False))
    with pytest.raises(ValueError, match="expected Adam's moments"):
        train_tiny(tmp_path, tiny_config(20, checkpoint_keep_moments=False))


@pytest.mark.parametrize(
    "keys",
    [
        {"sampler": "views_at_one_time"},
        {"sampler": "times_of_one_view"},
        {"optimiser": "sparse_adam"},
        {"batch": 1},
        {"resolution_steps": [ResolutionStep(0.5, 0.5)]},
        {"resolution_scale": 0.5},
        {"rigid_weight": 1.0},
    ],
)
def test_every_option_runs(tmp_path, keys: dict) -> None:
    assert train_tiny(tmp_path, tiny_config(12, **keys)).iteration == 12


def test_time_budget_ends_the_run_with_an_evaluation_and_a_checkpoint(tmp_path) -> None:
    result = train_tiny(tmp_path, tiny_config(100_000, time_budget_s=0.3, eval_every=10**6, checkpoint_every=10**6))
    assert result.iteration < 100_000 and result.train_seconds >= 0.3
    assert checkpoint.load(tmp_path / checkpoint.FILE_NAME).iteration == result.iteration
    assert [row["iteration"] for row in TinyRun(tmp_path).rows("error_vs_time.jsonl")] == [result.iteration]


def test_evaluation_is_off_the_clock(tmp_path) -> None:
    def slow(model: Model, progress) -> dict:
        time.sleep(0.5)
        return fake_evaluate(model, progress)

    cfg, scene = tiny_config(4, eval_every=1), tiny_scene()
    model = initialise(scene, cfg, np.random.default_rng(0))
    started = time.perf_counter()
    result = train(model, scene, cfg, TinyRun(tmp_path), slow)
    assert time.perf_counter() - started > 2 > 1.9 > result.train_seconds


def poison_gradient(monkeypatch, at_call: int, row: int) -> None:
    """From the `at_call`-th view on, that view's backward pass puts a NaN into the mean's gradient."""
    original, names = step.Batch.backward, []

    def backward(self, target, background, gradients):
        view = original(self, target, background, gradients)
        names.append(target.name)
        if target.name == names[min(at_call, len(names) - 1)] and len(names) > at_call:
            gradients.mean[row, 1] = float("nan")
        return view

    monkeypatch.setattr(step.Batch, "backward", backward)


def test_non_finite_gradient_names_iteration_view_and_gaussian(tmp_path, monkeypatch) -> None:
    poison_gradient(monkeypatch, at_call=2 * 8 + 1, row=13)  # the second view of the ninth batch
    with pytest.raises(finite_checks.NonFiniteError, match=r"iteration 9, view train/r_\d: .* mean of Gaussian 13") as error:
        train_tiny(tmp_path)
    assert "\n" not in str(error.value)
    saved = checkpoint.load(tmp_path / checkpoint.FILE_NAME)
    assert saved.iteration == 7 and saved.model.first_non_finite() is None, "the last good checkpoint is kept"


def test_a_view_that_breaks_over_one_background_is_found(tmp_path, monkeypatch) -> None:
    """Random backgrounds: the search for the broken view renders each view over the colour it was trained over."""
    original = step.Batch.backward

    def backward(self, target, background, gradients):
        view = original(self, target, background, gradients)
        if background[0] > 0.9:
            gradients.mean[13, 1] = float("nan")
        return view

    monkeypatch.setattr(step.Batch, "backward", backward)
    scene = tiny_scene()
    views = tuple(replace(view, coverage=np.uint8(255) * (view.image[..., 0] > 0)) for view in scene.train)
    with pytest.raises(finite_checks.NonFiniteError, match=r"iteration \d+, view train/r_\d: .* mean of Gaussian 13"):
        train_tiny(tmp_path, tiny_config(random_background=True), replace(scene, train=views))


def test_the_log_counts_the_gaussians_that_were_rendered(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(loop, "SHOW_EVERY", 1)
    monkeypatch.setattr(loop, "LOG_EVERY", 1)
    train_tiny(tmp_path)
    rows = TinyRun(tmp_path).rows("log.jsonl")
    after, total = {row["iteration"]: row["n_gaussians"] for row in rows if row["event"] == "densify"}, 200
    assert len(set(after.values())) > 1, "densification changes how many there are"
    for row in (row for row in rows if row["event"] == "train"):
        assert row["n_alive"] <= row["n_gaussians"] == total
        total = after.get(row["iteration"], total)


def test_non_finite_loss_names_iteration_and_view(tmp_path, monkeypatch) -> None:
    original, calls = step.view_loss, []

    def view_loss(criterion, image, *rest):
        calls.append(1)
        return original(criterion, image * float("nan") if len(calls) == 6 else image, *rest)

    monkeypatch.setattr(step, "view_loss", view_loss)
    with pytest.raises(finite_checks.NonFiniteError, match=r"iteration 3, view train/r_\d: expected a finite loss, found nan"):
        train_tiny(tmp_path)


def test_a_broken_model_never_replaces_a_good_checkpoint() -> None:
    model = initialise(tiny_scene(), tiny_config(), np.random.default_rng(0))
    finite_checks.check_model(model, 5)
    model.parameters["log_scale"][17, 2] = float("inf")
    with pytest.raises(finite_checks.NonFiniteError, match="iteration 5: .* log_scale of Gaussian 17"):
        finite_checks.check_model(model, 5)


def test_coarser_views_are_averaged_over_areas() -> None:
    view = tiny_scene().train[0]
    half = target_of(view, 0.5)
    expected = view.image.reshape(16, 2, 16, 2, 3).mean(axis=(1, 3)).transpose(2, 0, 1) / 255
    np.testing.assert_allclose(half.image.numpy(), expected, atol=1e-6)  # float32 of values up to 1
    assert (half.camera.width, half.camera.fx, half.camera.cx) == (16, 20.0, 8.0)
    np.testing.assert_allclose(area_weights(3, 2), [[2 / 3, 1 / 3, 0], [0, 1 / 3, 2 / 3]], atol=1e-7)
    whole = target_of(view, 1.0)
    np.testing.assert_array_equal(whole.image.numpy() * 255, view.image.transpose(2, 0, 1))


def test_views_are_remembered_only_while_memory_allows() -> None:
    views = tiny_scene().train
    kept, not_kept = TrainingViews(views), TrainingViews(views, cache_limit_bytes=1000)
    assert kept.at(2, 0.5) is kept.at(2, 0.5) and not_kept.at(2, 0.5) is not not_kept.at(2, 0.5)
    assert kept.at(2, 1.0).image.shape == (3, 32, 32), "another scale is another image"
