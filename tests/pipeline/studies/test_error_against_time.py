"""Error against time: means of curves with known values, runs that were stopped, and one-line errors."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
from report_runs import write_run

from pipeline.studies.error_against_time.__main__ import main
from pipeline.studies.error_against_time.curves import by_recipe, mean_until_stopped, read_curves, value_at


def write_curve(
    root: Path, scene: str, points: list[tuple[float, float]], recipe: str = "fast", stopped: bool = False
) -> None:
    """A run whose evaluations are `points` (CPU seconds, PSNR)."""
    folder = write_run(root, scene, recipe=recipe)
    rows = [f"{seconds},{seconds},{k},{psnr},100" for k, (seconds, psnr) in enumerate(points)]
    head = "train_seconds,cpu_seconds,iteration,psnr,n_gaussians"
    (folder / "error_vs_time.csv").write_text("\n".join([head, *rows]) + "\n")
    made = json.loads((folder / "environment.json").read_text())
    (folder / "environment.json").write_text(json.dumps(made | {"rendered_by": {"engine": "kernel_v4"}}))
    if stopped:
        (folder / "metrics.json").unlink()


def test_the_mean_is_taken_at_equal_times_and_a_finished_run_keeps_its_value(tmp_path: Path) -> None:
    write_curve(tmp_path, "dnerf/a", [(10, 20), (30, 40)])  # 10 + t
    write_curve(tmp_path, "dnerf/b", [(20, 10), (60, 30)])  # t / 2
    times, psnr = mean_until_stopped(by_recipe(read_curves(tmp_path), tmp_path)["fast, kernel_v4"])
    assert list(times) == [20, 30, 60]  # both have begun from 20 on
    assert list(psnr) == [(30 + 10) / 2, (40 + 15) / 2, (40 + 30) / 2]
    assert value_at(times, psnr, 10, last=True) is None and value_at(times, psnr, 25, last=True) == 23.75
    assert value_at(times, psnr, 90, last=True) == 35 and value_at(times, psnr, 90, last=False) is None


def test_the_mean_ends_where_the_first_run_was_stopped(tmp_path: Path) -> None:
    write_curve(tmp_path, "dnerf/a", [(10, 20), (30, 40)], stopped=True)
    write_curve(tmp_path, "dnerf/b", [(5, 10), (40, 45)])
    times, _ = mean_until_stopped(by_recipe(read_curves(tmp_path), tmp_path)["fast, kernel_v4"])
    assert list(times) == [10, 30]


def test_command_writes_table_figure_and_every_evaluation(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    for scene in ("dnerf/a", "dnerf/b"):
        write_curve(tmp_path / "runs", scene, [(10, 20), (30, 40)])
        write_curve(tmp_path / "runs", scene, [(20, 10), (70, 20)], recipe="paper", stopped=True)
    assert main([str(tmp_path / "runs"), "--out", str(tmp_path / "out")]) == 0
    text = capsys.readouterr().out
    assert "| fast, kernel_v4 | 25.00 | 40.00 | 40.00 | 40.00 after 30 s |" in text
    assert "| paper, kernel_v4 |  | 12.00 | 18.00 | stopped |" in text
    with (tmp_path / "out/error_against_time.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["scene"], row["finished"], row["psnr"]) for row in rows[:2]] == [
        ("dnerf/a", "1", "20.000"),
        ("dnerf/a", "1", "40.000"),
    ]
    assert len(rows) == 8 and (tmp_path / "out/error_against_time.svg").read_text().startswith("<?xml")


def test_runs_that_cannot_be_compared_are_a_one_line_error(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert main([str(tmp_path)]) == 1
    assert "expected folders of runs, found none" in capsys.readouterr().err
    write_curve(tmp_path, "dnerf/a", [(10, 20)])
    write_curve(tmp_path, "dnerf/b", [(10, 20)], recipe="paper")
    assert main([str(tmp_path)]) == 1
    assert "expected the scenes of fast, kernel_v4 for paper, kernel_v4: dnerf/a, found dnerf/b" in (
        error := capsys.readouterr().err
    )
    assert error.count("\n") == 1
    write_run(tmp_path, "dnerf/c")  # without CPU seconds
    assert main([str(tmp_path)]) == 1
    assert "error_vs_time.csv of a run" in capsys.readouterr().err
