"""Learning curves averaged over scenes, on hand-made curves."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from report_runs import write_run

from pipeline.report.build import plots_of
from pipeline.report.mean_curves import with_means
from pipeline.report.runs import collect

CPU = {"threads": 2, "multiply_adds_per_s": 100e9, "bytes_per_s": 15e9}
HEAD = "train_seconds,cpu_seconds,iteration,psnr,ssim,test_loss,n_gaussians,psnr_moving"
MEAN = "Synthetic scenes, mean of 2"


def write_curve(root: Path, scene: str, recipe: str, rows: list[str], **values) -> None:
    folder = write_run(root, scene, recipe=recipe, cpu=CPU, **values)
    (folder / "error_vs_time.csv").write_text("\n".join([HEAD, *rows]) + "\n")


def test_the_mean_of_a_family_is_that_of_equal_cpu_seconds(tmp_path: Path) -> None:
    write_curve(tmp_path, "synthetic/wheel", "fast", ["9,10,1,20,0.8,0.1,100,", "9,30,2,24,0.9,0.1,300,"])
    write_curve(tmp_path, "synthetic/lamp", "fast", ["10,,1,30,0.6,0.1,50,", "20,,2,32,0.8,0.1,70,"])  # 20 and 40 s
    write_curve(tmp_path, "synthetic/wheel", "paper", ["9,10,1,20,0.8,0.1,100,", "9,30,2,24,0.9,0.1,300,"])
    curves = with_means(collect(tmp_path)).curves
    found = curves[curves["scene_label"] == MEAN]
    assert set(found["recipe_label"]) == {"fast"}, "`paper` has not trained all scenes"
    assert found["cpu_seconds"].tolist() == [20, 30, 40]
    assert found["psnr"].tolist() == [(22 + 30) / 2, (24 + 31) / 2, (24 + 32) / 2]
    assert found["n_gaussians"].tolist() == [(200 + 50) / 2, (300 + 60) / 2, (300 + 70) / 2]
    assert found["ssim"].tolist() == pytest.approx([(0.85 + 0.6) / 2, (0.9 + 0.7) / 2, (0.9 + 0.8) / 2])


def test_it_is_drawn_first_without_iterations_and_only_of_several_scenes(tmp_path: Path) -> None:
    rows = ["9,10,1,20,0.8,0.1,100,", "9,30,2,24,0.9,0.1,300,"]
    write_curve(tmp_path, "synthetic/wheel", "fast", rows)
    assert [plot.title for plot in plots_of(collect(tmp_path))] == ["synthetic/wheel: fast"]
    write_curve(tmp_path, "synthetic/lamp", "fast", rows)
    write_curve(tmp_path, "dnerf/hook", "fast", rows)
    first, *others = plots_of(collect(tmp_path))
    assert first.title == f"{MEAN}: fast"
    assert [plot.title for plot in others] == ["synthetic/wheel: fast", "synthetic/lamp: fast", "dnerf/hook: fast"]
    said = "".join(ElementTree.fromstring(first.light).itertext())
    assert "CPU seconds" in said and "iteration" not in said
