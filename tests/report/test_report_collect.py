"""Reading runs: unfinished, damaged and copied ones; selection of time-varying colour."""

from __future__ import annotations

import pytest
from report_runs import write_run

from pipeline.report.__main__ import main
from pipeline.report.tables.run_tables import all_runs
from pipeline.runs.read.collect import collect
from pipeline.runs.read.variants import name_variants


@pytest.mark.parametrize(
    "damage, message",
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
                (f / "metrics.json").read_text().replace('"seed"', '"select_time_colour": 3, "seed"')
            ),
            "select_time_colour: expected an object, found 3",
        ),
        (
            lambda f: (f / "metrics.json").write_text(
                (f / "metrics.json").read_text().replace('"seed"', '"select_motion": 3, "seed"')
            ),
            "select_motion: expected an object, found 3",
        ),
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


def test_copied_run_counts_once(tmp_path):
    write_run(tmp_path, "synthetic/wheel")
    write_run(tmp_path, "synthetic/wheel", out="copy")
    found = name_variants(collect(tmp_path))
    assert len(found.runs) == 1
    assert found.left_out == (
        "synthetic/wheel/full/fast/seed0: left out: same scene, ablation, settings and seed as copy",
    )


def test_a_run_of_before_a_key_was_added_is_another_seed_of_the_same(tmp_path):
    write_run(tmp_path, "synthetic/wheel", seed=0)
    write_run(tmp_path, "synthetic/wheel", seed=1, settings="  dropout: 0.0\n", scene_settings="  camera_path: jumps\n")
    write_run(tmp_path, "synthetic/wheel", seed=2, settings="  dropout: 0.1\n", scene_settings="  camera_path: jumps\n")
    assert name_variants(collect(tmp_path)).runs["train"].tolist() == ["fast", "fast", "fast (dropout=0.1)"]


@pytest.mark.parametrize("key", ["select_time_colour", "trial"])  # its name today and up to version 0.1
def test_result_of_selection_is_in_the_table_of_all_runs(tmp_path, key: str):
    for scene, selection in (
        ("lamp", {"gain": 1.126, "standard_error": 0.094, "kept": True}),
        ("still", None),
        ("wheel", {"gain": 0.05, "standard_error": 0.05, "kept": False}),
    ):
        write_run(tmp_path, f"synthetic/{scene}", **{key: selection})
    table = all_runs(collect(tmp_path).runs)
    cells = [row.cells["selection"].text for row in table.rows]
    assert cells == ["+1.13 ± 0.09: kept", "none", "+0.05 ± 0.05: left out"]
    assert any("Selection of 4DSH" in note for _, note in table.notes)


def test_no_column_without_selection(tmp_path):
    write_run(tmp_path, "synthetic/lamp")
    table = all_runs(collect(tmp_path).runs)
    texts = (*(column.header for column in table.columns), *(note for _, note in table.notes))
    assert not any("Selection" in text for text in texts)
