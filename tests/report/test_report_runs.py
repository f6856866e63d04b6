"""Runs the report must not trust: broken, damaged, copied, or of other settings than their name says."""

from __future__ import annotations

import json

import pytest
from report_runs import write_run

from pipeline.report.__main__ import main
from pipeline.report.tables.run_tables import all_runs
from pipeline.runs.read.collect import collect
from pipeline.runs.read.variants import name_variants


@pytest.mark.parametrize(
    "damage, said",
    [
        (lambda f: (f / "metrics.json").unlink(), "unfinished: no metrics.json"),
        (lambda f: (f / "metrics.json").write_text('{"final": '), "expected JSON"),
        (lambda f: (f / "metrics.json").write_text("[1]"), "expected an object, found list"),
        (
            lambda f: (f / "metrics.json").write_text((f / "metrics.json").read_text().replace("25.0", "NaN")),
            "final.psnr: expected a finite number, found nan",
        ),
        (
            lambda f: (f / "metrics.json").write_text((f / "metrics.json").read_text().replace("12345", '"many"')),
            "n_gaussians: expected a finite number, found 'many'",
        ),
        (
            lambda f: (f / "metrics.json").write_text(
                (f / "metrics.json").read_text().replace('"seed"', '"trial": 3, "seed"')
            ),
            "trial: expected an object, found 3",
        ),
        (lambda f: (f / "config.yaml").write_text("a: [1"), "config.yaml: expected YAML"),
    ],
)
def test_a_broken_run_is_named_in_one_line_and_left_out(tmp_path, capsys, damage, said):
    write_run(tmp_path, "synthetic/wheel", seed=0)
    damage(write_run(tmp_path, "synthetic/wheel", seed=1))
    found = collect(tmp_path)
    assert list(found.runs["seed"]) == [0]  # the other run still counts
    assert len(found.left_out) == 1 and "\n" not in found.left_out[0]
    assert found.left_out[0].startswith("synthetic/wheel/full/fast/seed1: left out: ")
    assert said in found.left_out[0]


def test_a_broken_run_is_named_on_stderr_and_in_the_report(tmp_path, capsys):
    write_run(tmp_path / "runs", "synthetic/wheel", seed=0)
    (write_run(tmp_path / "runs", "synthetic/wheel", seed=1) / "metrics.json").unlink()
    assert main([str(tmp_path / "runs")]) == 0
    line = "synthetic/wheel/full/fast/seed1: left out: unfinished: no metrics.json"
    assert capsys.readouterr().err == f"warning: {line}\n"
    assert all(line in (tmp_path / "report" / name).read_text() for name in ("report.html", "report.md"))


def test_a_damaged_curve_costs_the_curve_not_the_run(tmp_path):
    folder = write_run(tmp_path, "synthetic/wheel")
    with (folder / "error_vs_time.csv").open("a") as file:
        file.write("70.0,1100\n")
    found = collect(tmp_path)
    assert len(found.runs) == 1 and found.curves.empty
    assert found.warnings == (
        "synthetic/wheel/full/fast/seed0: error_vs_time.csv: expected numbers, found none in line 6",
    )


def test_a_curve_line_cut_short_by_a_kill_is_dropped(tmp_path):
    folder = write_run(tmp_path, "synthetic/wheel")
    with (folder / "error_vs_time.csv").open("a") as file:
        file.write("70.0,1100,25.1,0.8,0.1,12")  # the count was to be 12345
    found = collect(tmp_path)
    assert list(found.curves["iteration"]) == [250, 500, 750, 1000] and not found.warnings


@pytest.mark.parametrize(
    "make, advice",
    [
        (lambda p: None, "make one: python -m pipeline scene=synthetic/wheel train=fast"),
        (lambda p: p.mkdir(), "make one: python -m pipeline scene=synthetic/wheel train=fast"),
        (lambda p: p.write_text("x"), "make one: python -m pipeline scene=synthetic/wheel train=fast"),
        (
            lambda p: (p / "a").mkdir(parents=True) or (p / "a/config.yaml").write_text(""),
            "an interrupted run goes on when its command is given again",
        ),
    ],
)
def test_nothing_to_report_is_one_line_that_says_what_to_do_and_a_failure(tmp_path, capsys, make, advice):
    make(tmp_path / "runs")
    assert main([str(tmp_path / "runs")]) == 1
    said = capsys.readouterr().err
    assert said.startswith(f"error: {tmp_path / 'runs'}: expected") and said.count("\n") == 1 and advice in said
    assert not (tmp_path / "report").exists()


def test_runs_with_other_settings_are_not_averaged_under_one_name(tmp_path):
    write_run(tmp_path, "synthetic/wheel", seed=0)
    write_run(tmp_path, "synthetic/wheel", seed=1)
    write_run(tmp_path, "synthetic/wheel", seed=2, iterations=600)
    runs = name_variants(collect(tmp_path)).runs
    assert sorted(runs["train"]) == ["fast", "fast", "fast (iterations=600)"]


def test_what_a_command_changed_is_part_of_the_name(tmp_path):
    folder = write_run(tmp_path, "synthetic/wheel")
    environment = json.loads((folder / "environment.json").read_text())
    environment["command"] += " train=paper train.densify.max_gaussians=50000 train.checkpoint_every=10"
    (folder / "environment.json").write_text(json.dumps(environment))
    assert list(name_variants(collect(tmp_path)).runs["train"]) == ["fast (densify.max_gaussians=50000)"]


def test_a_copied_run_counts_once(tmp_path):
    write_run(tmp_path, "synthetic/wheel")
    write_run(tmp_path, "synthetic/wheel", out="copy")
    found = name_variants(collect(tmp_path))
    assert len(found.runs) == 1
    assert found.left_out == (
        "synthetic/wheel/full/fast/seed0: left out: same scene, ablation, settings and seed as copy",
    )


def test_what_a_trial_said_stands_beside_the_run(tmp_path):
    write_run(tmp_path, "synthetic/lamp", trial={"gain": 1.126, "standard_error": 0.094, "kept": True})
    write_run(tmp_path, "synthetic/still", trial=None)
    write_run(tmp_path, "synthetic/wheel", trial={"gain": 0.05, "standard_error": 0.05, "kept": False})
    table = all_runs(collect(tmp_path).runs)
    assert [row.cells["trial"].text for row in table.rows] == ["+1.13 ± 0.09: kept", "none", "+0.05 ± 0.05: left out"]
    assert any("Trial of 4DSH" in note for _, note in table.notes)


def test_without_a_trial_nothing_is_said_of_one(tmp_path):
    write_run(tmp_path, "synthetic/lamp")
    table = all_runs(collect(tmp_path).runs)
    assert not any("Trial" in said for said in (*(c.header for c in table.columns), *(note for _, note in table.notes)))
