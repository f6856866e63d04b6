"""Video length: exponents and tables from runs with known numbers, one-line errors."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from report_runs import write_run

from pipeline.studies.video_length.__main__ import exponent, main, read_lengths


def write_length(root: Path, frames: int, seed: int = 0, iterations: int = 100, **changes) -> Path:
    folder = write_run(
        root, "synthetic/counter", seed=seed, out=f"frames{frames}/seed{seed}", iterations=iterations, **changes
    )
    config = (folder / "config.yaml").read_text()
    (folder / "config.yaml").write_text(config.replace("  path: null\n", f"  path: null\n  frames: {frames}\n"))
    return folder


def test_exponents_and_means_over_seeds(tmp_path: Path) -> None:
    for frames in (10, 20, 80):
        for seed, factor in enumerate((0.9, 1.1)):
            write_length(tmp_path, frames, seed, n_gaussians=factor * 500 * frames**0.8, n_alive_mean=factor * 300.0)
    found = read_lengths(tmp_path)
    assert list(found) == [10, 20, 80]
    assert found[20]["gaussians"].mean() == pytest.approx(500 * 20**0.8) and len(found[20]["alive"]) == 2
    assert exponent(found, "gaussians") == pytest.approx(0.8)
    assert exponent(found, "alive") == pytest.approx(0.0, abs=1e-12)


def test_command_writes_table_and_csv(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    for frames in (15, 30):
        write_length(tmp_path / "runs", frames, n_gaussians=100 * frames, n_alive_mean=700.0)
    assert main([str(tmp_path / "runs"), "--out", str(tmp_path / "out")]) == 0
    with (tmp_path / "out/video_length.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(int(row["frames"]), float(row["gaussians"])) for row in rows] == [(15, 1500.0), (30, 3000.0)]
    text = (tmp_path / "out/video_length.md").read_text()
    assert text in capsys.readouterr().out and "Gaussians 1.00; active in a frame 0.00" in text


@pytest.mark.parametrize(
    "lengths, error",
    [
        ([(15, 100)], "scene.frames: expected runs of at least two lengths, found only 15"),
        (
            [(15, 100), (30, 200)],
            "frames30/seed0: expected the settings of frames15/seed0 except scene.frames and seed, "
            "found another train.iterations",
        ),
    ],
)
def test_runs_that_cannot_be_compared_are_a_one_line_error(
    tmp_path: Path, capsys: pytest.CaptureFixture, lengths: list[tuple[int, int]], error: str
) -> None:
    for frames, iterations in lengths:
        write_length(tmp_path / "runs", frames, iterations=iterations)
    assert main([str(tmp_path / "runs"), "--out", str(tmp_path / "out")]) == 1
    assert capsys.readouterr().err == f"error: {error}\n" and not (tmp_path / "out").exists()


def test_folder_without_runs_is_a_one_line_error(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert main([str(tmp_path / "nothing")]) == 1
    assert capsys.readouterr().err.count("\n") == 1
