"""Reading runs: what they declare, labels; unfinished, damaged and repeated ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from report_runs import write_run

from pipeline.report.__main__ import main
from pipeline.report.runs import collect, label


def edited(before: str, after: str) -> Callable[[Path], object]:
    """Replaces text in metrics.json."""

    def edit(folder: Path) -> None:
        path = folder / "metrics.json"
        assert before in path.read_text()
        path.write_text(path.read_text().replace(before, after))

    return edit


@pytest.mark.parametrize(
    "damage, message",
    [
        (lambda f: (f / "metrics.json").unlink(), "unfinished: no metrics.json"),
        (lambda f: (f / "metrics.json").write_text('{"final": '), "expected JSON"),
        (lambda f: (f / "metrics.json").write_text("[1]"), "expected an object, found list"),
        (edited("25.0", "NaN"), "final.psnr: expected a finite number, found nan"),
        (edited("12345", '"many"'), "n_gaussians: expected a finite number, found 'many'"),
        (edited('"recipe": "fast", ', ""), "recipe: expected a name, found None"),
        (edited('"changes": {}', '"changes": [1]'), "changes: expected an object, found [1]"),
        (edited('"seed": 1', '"seed": -1'), "seed: expected an integer in 0.."),
        (edited('"monocular"', '"odd"'), "capture: expected static, monocular, clip, multi_view, drive, found 'odd'"),
        (lambda f: (f / "config.yaml").write_text("a: [1"), "config.yaml: expected YAML"),
    ],
)
def test_damaged_run_is_left_out_and_named_in_one_line(tmp_path, damage, message):
    write_run(tmp_path, "synthetic/wheel", seed=0)
    damage(write_run(tmp_path, "synthetic/wheel", seed=1))
    found = collect(tmp_path)
    assert list(found.runs["seed"]) == [0]  # the other run still counts
    assert len(found.left_out) == 1 and "\n" not in found.left_out[0]
    assert found.left_out[0].startswith("synthetic/wheel/full/fast/seed1: left out: ")
    assert message in found.left_out[0]


def test_damaged_run_is_named_on_stderr_and_in_the_report(tmp_path, capsys):
    write_run(tmp_path / "runs", "synthetic/wheel", seed=0)
    (write_run(tmp_path / "runs", "synthetic/wheel", seed=1) / "metrics.json").unlink()
    assert main([str(tmp_path / "runs")]) == 0
    line = "synthetic/wheel/full/fast/seed1: left out: unfinished: no metrics.json"
    assert capsys.readouterr().err == f"warning: {line}\n"
    assert all(line in (tmp_path / "report" / name).read_text() for name in ("report.html", "report.md"))


def test_run_with_a_damaged_curve_is_kept_without_it(tmp_path):
    folder = write_run(tmp_path, "synthetic/wheel")
    with (folder / "error_vs_time.csv").open("a") as file:
        file.write("70.0,1100\n")
    found = collect(tmp_path)
    assert len(found.runs) == 1 and found.curves.empty
    assert found.warnings == (
        "synthetic/wheel/full/fast/seed0: error_vs_time.csv: expected numbers, found none in line 6",
    )


def test_incomplete_last_line_of_a_curve_is_dropped(tmp_path):
    folder = write_run(tmp_path, "synthetic/wheel")
    with (folder / "error_vs_time.csv").open("a") as file:
        file.write("70.0,1100,25.1,0.8,0.1,12")  # of 12345
    found = collect(tmp_path)
    assert list(found.curves["iteration"]) == [250, 500, 750, 1000] and not found.warnings


@pytest.mark.parametrize(
    "make, advice",
    [
        (lambda p: None, "start a run: python -m pipeline scene=synthetic/wheel train=fast"),
        (lambda p: p.mkdir(), "start a run: python -m pipeline scene=synthetic/wheel train=fast"),
        (lambda p: p.write_text("x"), "start a run: python -m pipeline scene=synthetic/wheel train=fast"),
        (
            lambda p: (p / "a").mkdir(parents=True) or (p / "a/config.yaml").write_text(""),
            "to resume an interrupted run, repeat its command",
        ),
    ],
)
def test_no_runs_is_an_error_with_advice(tmp_path, capsys, make, advice):
    make(tmp_path / "runs")
    assert main([str(tmp_path / "runs")]) == 1
    printed = capsys.readouterr().err
    assert (
        printed.startswith(f"error: {tmp_path / 'runs'}: expected") and printed.count("\n") == 1 and advice in printed
    )
    assert not (tmp_path / "report").exists()


def test_a_repeated_run_is_left_out(tmp_path):
    write_run(tmp_path, "synthetic/wheel", changes={"train.batch": 4})
    write_run(tmp_path, "synthetic/wheel", changes={"train.batch": 4}, out="copy")
    found = collect(tmp_path)
    assert list(found.runs["run"]) == ["copy"] and set(found.curves["run"]) == {"copy"}
    assert found.left_out == (
        "synthetic/wheel/full/fast/seed0: left out: same scene, recipe, model, changes and seed as copy",
    )


def test_a_run_of_before_it_declared_what_it_is_is_left_out_with_one_line(tmp_path, capsys):
    write_run(tmp_path / "runs", "synthetic/wheel")
    (tmp_path / "runs/old").mkdir()
    (tmp_path / "runs/old/metrics.json").write_text('{"scene": "synthetic/wheel", "train": "fast", "seed": 0}')
    assert main([str(tmp_path / "runs")]) == 0
    line = "old: left out: metrics.json: recipe: expected a name, found None"
    assert capsys.readouterr().err == f"warning: {line}\n"


def test_labels_show_what_the_run_declares(tmp_path):
    """Changes of the scene belong to the scene, all others to the recipe, in one order."""
    changes = {"train.batch": 4, "scene.downscale": 2, "init.source": "random", "train.resolution_steps": [1, 2]}
    write_run(tmp_path, "dnerf/lego", changes=changes, out="changed", decided={"fourier_order": 0, "static": False})
    write_run(tmp_path, "dnerf/lego")
    rows = collect(tmp_path).runs.to_dict("records")
    changed, plain = sorted(rows, key=lambda row: -len(row["changes"]))
    assert changed["scene_label"] == "dnerf/lego (scene.downscale=2)"
    others = "init.source=random, train.batch=4, train.resolution_steps=[1, 2]"
    assert (changed["recipe_label"], changed["changed"]) == (f"fast ({others})", True)
    assert changed["method"] == label("fast", changes)
    assert (changed["scene"], changed["recipe"], changed["model"]) == ("dnerf/lego", "fast", "full")
    assert changed["trained"] == "fourier_order=2, motion=full, sh_degree=3"
    assert changed["validation"] == "fourier_order=0, static=false"
    assert (plain["scene_label"], plain["recipe_label"], plain["changed"]) == ("dnerf/lego", "fast", False)
    assert plain["validation"] == "nothing"


def test_a_run_says_that_validation_took_shared_motion(tmp_path):
    kind = {"motion": "velocity", "fourier_order": 0, "sh_degree": 3, "trajectories": 32}
    write_run(tmp_path, "dnerf/hook", kind=kind, decided={"shared_motion": True, "fourier_order": 0})
    (row,) = collect(tmp_path).runs.to_dict("records")
    assert row["validation"] == "fourier_order=0, shared_motion=true"
    assert row["trained"] == "fourier_order=0, motion=velocity, sh_degree=3, trajectories=32"
    assert row["recipe_label"] == "fast", "a decision is no change"


def test_runs_of_several_machines_are_one_collection(tmp_path, capsys):
    """The one seed that both have counts once; a folder within another one, too."""
    for machine, seeds in {"a/runs": (0, 1), "b/runs": (1, 2)}.items():
        for seed in seeds:
            write_run(tmp_path / machine, "synthetic/wheel", seed=seed)
    roots = [tmp_path / name for name in ("a/runs", "b/runs", "b/runs/synthetic")]
    found = collect(*roots)
    name = "runs/synthetic/wheel/full/fast/seed"
    assert list(found.runs["run"]) == [f"a/{name}0", f"a/{name}1", f"b/{name}2"]
    assert set(found.curves["run"]) == set(found.settings) == set(found.runs["run"])
    repeated = f"b/{name}1: left out: same scene, recipe, model, changes and seed as a/{name}1"
    assert found.left_out == (repeated,)
    assert main([*map(str, roots)]) == 0
    assert capsys.readouterr().err == f"warning: {repeated}\n" and (tmp_path / "a/report/report.html").exists()


def test_a_folder_that_is_missing_among_several_is_an_error(tmp_path, capsys):
    write_run(tmp_path / "runs", "synthetic/wheel")
    assert main([str(tmp_path / "runs"), str(tmp_path / "none")]) == 1
    assert capsys.readouterr().err.startswith(f"error: {tmp_path / 'none'}: expected a folder of runs, found nothing")
