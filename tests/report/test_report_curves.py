"""Learning curves: grouping into figures, mean and std over seeds, coarse-resolution part, SVG."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from report_runs import write_run

from pipeline.presentation.theme import DARK
from pipeline.report.compare.curve_figures import CurveFigure, curve_figures
from pipeline.report.compare.curve_statistics import end_of_coarse, mean_and_std, split_at
from pipeline.report.write.plots import plot
from pipeline.runs.read.collect import Collection, collect
from pipeline.runs.read.variants import name_variants

FAST = {"batch": "1", "optimiser": "sparse_adam", "resolution_steps": "[{until: 0.5, scale: 0.5}]", "init_points": "20"}


def write_variant(
    root: Path, name: str, ablation: str = "full", train: str = "fast", overrides: Sequence[str] = (), **changes
) -> None:
    """Runs of `fast` with some keys of the schedule changed, in a folder called `name`."""
    settings = "".join(f"  {key}: {value}\n" for key, value in (FAST | changes).items())
    for seed in range(2):
        write_run(
            root,
            "synthetic/wheel",
            ablation,
            train,
            seed,
            psnr=25 + 0.1 * seed,
            settings=settings,
            overrides=overrides,
            out=f"{name}/seed{seed}",
        )


def study(root: Path) -> Collection:
    """A small version of conf/experiment/training_curves.yaml."""
    write_variant(root, "adam", optimiser="adam")
    write_variant(root, "batch2", batch="2")
    write_variant(root, "batch4", batch="4")
    write_variant(root, "fast")
    write_variant(root, "full_size", resolution_steps="[]")
    write_variant(root, "no_4drot", ablation="no_4drot")
    write_variant(root, "paper", train="paper", batch="4", optimiser="adam", resolution_steps="[]", init_points="100")
    return name_variants(collect(root))


def lines_of(found: list[CurveFigure]) -> dict[str, list[str]]:
    return {figure.title: [line.label for line in figure.lines] for figure in found}


# --- grouping into figures -------------------------------------------------------------------------------------------


def test_one_figure_per_factor(tmp_path: Path) -> None:
    coarse = "fast (resolution_steps=[])"
    assert lines_of(curve_figures(study(tmp_path))) == {
        "synthetic/wheel: schedule": ["fast", "paper"],
        "synthetic/wheel: batch": ["fast", "fast (batch=2)", "fast (batch=4)"],
        "synthetic/wheel: resolution": ["fast", coarse],
        "synthetic/wheel: optimiser": ["fast", "fast (optimiser=adam)"],
        "synthetic/wheel: ablation, fast": ["full", "no_4drot"],
    }


def test_one_figure_of_ablations_per_schedule(tmp_path: Path) -> None:
    for train in ("fast", "paper"):
        for ablation in ("full", "no_4drot"):
            write_run(tmp_path, "synthetic/wheel", ablation, train)
    assert lines_of(curve_figures(collect(tmp_path))) == {
        "synthetic/wheel: ablation, fast": ["full", "no_4drot"],
        "synthetic/wheel: ablation, paper": ["full", "no_4drot"],
    }


def test_every_curve_is_in_a_figure_of_its_scene(tmp_path: Path) -> None:
    write_run(tmp_path, "synthetic/lamp")
    write_run(tmp_path, "synthetic/wheel")
    write_run(tmp_path, "synthetic/wheel", train="paper")
    (write_run(tmp_path, "synthetic/wheel", train="mine") / "config.yaml").unlink()
    found = collect(tmp_path)
    assert lines_of(curve_figures(found)) == {
        "synthetic/wheel: schedule": ["fast", "paper"],
        "synthetic/wheel: mine": ["mine"],
        "synthetic/lamp: fast": ["fast"],
    }


def test_titles_and_slugs_are_unique(tmp_path: Path) -> None:
    for batch in (1, 4):
        for optimiser in ("adam", "sparse_adam"):
            write_variant(tmp_path, f"{optimiser}{batch}", batch=str(batch), optimiser=optimiser)
    found = curve_figures(name_variants(collect(tmp_path)))
    assert len({c.slug for c in found}) == len({c.title for c in found}) == len(found) == 4
    assert all(re.fullmatch(r"[\w.-]+", c.slug) for c in found)


def test_unchanged_settings_are_found_without_a_majority(tmp_path: Path) -> None:
    """Each variant has as many runs as the unchanged schedule."""
    assert sorted(set(study(tmp_path).runs["train"])) == [
        "fast",
        "fast (batch=2)",
        "fast (batch=4)",
        "fast (optimiser=adam)",
        "fast (resolution_steps=[])",
        "paper",
    ]


def test_shared_overrides_are_in_the_title_only(tmp_path: Path) -> None:
    for batch in (1, 4):
        overrides = (f"train.batch={batch}", "train.fourier_at=[1, 2]")
        write_variant(tmp_path, f"batch{batch}", overrides=overrides, batch=str(batch))
    assert lines_of(curve_figures(name_variants(collect(tmp_path)))) == {
        "synthetic/wheel: batch, fourier_at=[1, 2]": ["fast (batch=1)", "fast (batch=4)"]
    }


# --- statistics of a curve -------------------------------------------------------------------------------------------


def curve(points: list[tuple[float, float]], run: str = "a") -> pd.DataFrame:
    rows = [{"train_seconds": x, "iteration": 100 * x, "psnr": y} for x, y in points]
    return pd.DataFrame(rows).assign(run=run)


def test_mean_and_std_between_evaluations_at_different_seconds() -> None:
    both = pd.concat([curve([(1, 10), (3, 14), (5, 16)]), curve([(2, 20), (4, 20), (6, 20)], "b")])
    x, mean, std = mean_and_std(both, "train_seconds", "psnr")
    assert x.tolist() == [2, 3, 4, 5]  # from where the second starts to where the first ends
    first = np.array([12, 14, 15, 16])  # by hand
    np.testing.assert_allclose(mean, (first + 20) / 2, rtol=1e-12)
    np.testing.assert_allclose(std, (20 - first) / math.sqrt(2), rtol=1e-12)  # of two values: their distance / √2


def test_end_of_coarse_resolution_training() -> None:
    steps = [{"until": 0.15, "scale": 0.25}, {"until": 0.5, "scale": 0.5}]
    both = pd.concat([curve([(2, 1), (8, 1), (10, 1)]), curve([(4, 1), (6, 1), (10, 1)], "b")])
    settings = {run: {"train.iterations": 1000, "train.resolution_steps": steps} for run in "ab"}
    assert end_of_coarse(both, settings, "iteration") == pytest.approx(500)
    assert end_of_coarse(both, settings, "train_seconds") == pytest.approx(5)
    # With a time budget of 5 s the schedule is at one half after 2.5 s.
    short = {run: one | {"train.time_budget_s": 5.0} for run, one in settings.items()}
    assert end_of_coarse(both, short, "train_seconds") == pytest.approx(2.5)
    assert end_of_coarse(both, {"a": {}, "b": {"train.resolution_steps": []}}, "iteration") == 0


@pytest.mark.parametrize(
    "at, before, after",
    [
        (0.0, [], [1, 2, 3]),
        (1.0, [], [1, 2, 3]),
        (2.0, [1, 2], [2, 3]),
        (2.5, [1, 2, 2.5], [2.5, 3]),
        (9.0, [1, 2, 3], []),
    ],
)
def test_split_parts_share_a_point(at: float, before: list[float], after: list[float]) -> None:
    xs = np.array([1.0, 2.0, 3.0])
    parts = split_at(xs, 10 * xs, at)
    for (x, y), expected in zip(parts, (before, after)):
        assert x.tolist() == expected and y.tolist() == [10 * value for value in expected]


# --- SVG -------------------------------------------------------------------------------------------------------------


def test_svg_has_labels_legend_and_caption(tmp_path: Path) -> None:
    collection = study(tmp_path)
    figures = {figure.title: figure for figure in curve_figures(collection)}
    resolution = figures["synthetic/wheel: resolution"]
    svg = plot(collection, resolution)
    assert plot(collection, resolution) == svg != plot(collection, resolution, DARK)
    ElementTree.fromstring(svg)
    for text in (
        "PSNR, dB, test views",
        "SSIM, test views",
        "loss, test views",
        "Gaussians",
        "training time, s",
        "iteration",
        "one standard deviation over seeds",
        "Dashed",
        "fast (resolution_steps=[])",
    ):
        assert text in svg, text
    paper = next(line for line in figures["synthetic/wheel: schedule"].lines if line.train == "paper")
    assert "Dashed" not in plot(collection, CurveFigure("synthetic/wheel", "paper alone", (paper,)))


def test_quantity_that_was_not_measured_has_no_panel(tmp_path: Path) -> None:
    folder = write_run(tmp_path, "synthetic/wheel")
    rows = pd.read_csv(folder / "error_vs_time.csv").assign(ssim=None).drop(columns="test_loss")
    rows.to_csv(folder / "error_vs_time.csv", index=False)
    found = collect(tmp_path)
    assert len(found.curves) == 4 and not found.warnings
    text = plot(found, curve_figures(found)[0])
    assert "PSNR, dB" in text and "SSIM" not in text and "loss" not in text
