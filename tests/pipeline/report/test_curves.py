"""Learning curves: grouping into figures, mean and std over seeds, coarse-resolution part, SVG."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from report_runs import write_run

from pipeline.presentation.theme import DARK, LIGHT
from pipeline.report.curve_figures import MOST_LINES, CurveFigure, curve_figures
from pipeline.report.plots import end_of_coarse, mean_and_interval, plot, recoloured, split_at
from pipeline.report.runs import Collection, collect

COARSE = "  resolution_steps: [{until: 0.5, scale: 0.5}]\n"


def study(root: Path) -> Collection:
    """Several recipes, settings and models of one scene, two seeds each."""
    for seed in range(2):
        psnr = 25 + 0.1 * seed
        write_run(root, "synthetic/wheel", seed=seed, psnr=psnr, settings=COARSE)
        write_run(root, "synthetic/wheel", "no_4drot", seed=seed, psnr=psnr, settings=COARSE)
        for batch in (2, 4):
            changes = {"train.batch": batch}
            out = f"batch{batch}/{seed}"
            write_run(root, "synthetic/wheel", seed=seed, psnr=psnr, settings=COARSE, changes=changes, out=out)
        write_run(root, "synthetic/wheel", recipe="paper", seed=seed, psnr=psnr)
    return collect(root)


def lines_of(found: list[CurveFigure]) -> dict[str, list[str]]:
    return {figure.title: [line.label for line in figure.lines] for figure in found}


# --- grouping into figures -------------------------------------------------------------------------------------------


def test_recipes_share_a_figure_and_models_of_a_recipe_another(tmp_path: Path) -> None:
    assert lines_of(curve_figures(study(tmp_path))) == {
        "synthetic/wheel: recipes": ["fast", "paper", "fast (train.batch=2)", "fast (train.batch=4)"],
        "synthetic/wheel: models, fast": ["full", "no_4drot"],
    }


def test_every_curve_is_in_a_figure_of_its_scene(tmp_path: Path) -> None:
    write_run(tmp_path, "synthetic/lamp")
    for recipe in ("fast", "paper"):
        for model in ("full", "no_4drot"):
            write_run(tmp_path, "synthetic/wheel", model, recipe)
    write_run(tmp_path, "synthetic/wheel", changes={"scene.size": 48}, out="small")
    write_run(tmp_path, "synthetic/burst", "no_4dsh")
    (write_run(tmp_path, "synthetic/still") / "config.yaml").unlink()
    write_run(tmp_path, "synthetic/still", "no_4dsh", "paper")
    assert lines_of(curve_figures(collect(tmp_path))) == {
        "synthetic/wheel: recipes": ["fast", "paper"],
        "synthetic/wheel: models, fast": ["full", "no_4drot"],
        "synthetic/wheel: models, paper": ["full", "no_4drot"],
        "synthetic/wheel (scene.size=48): fast": ["fast"],
        "synthetic/lamp: fast": ["fast"],
        "synthetic/burst: fast, no_4dsh": ["fast, no_4dsh"],
        "synthetic/still: recipes": ["fast", "paper, no_4dsh"],
    }


def test_many_recipes_are_split_with_the_first_in_each_figure(tmp_path: Path) -> None:
    write_run(tmp_path, "synthetic/wheel")
    for batch in range(2, 2 + MOST_LINES):
        write_run(tmp_path, "synthetic/wheel", changes={"train.batch": batch}, out=f"batch{batch}")
    found = curve_figures(collect(tmp_path))
    assert [len(figure.lines) for figure in found] == [MOST_LINES, 2]
    assert {figure.lines[0].label for figure in found} == {"fast"}
    assert len({figure.slug for figure in found}) == len({figure.title for figure in found}) == 2
    assert all(re.fullmatch(r"[\w.-]+", figure.slug) for figure in found)


# --- statistics of a curve -------------------------------------------------------------------------------------------


def curve(points: list[tuple[float, float]], run: str = "a") -> pd.DataFrame:
    rows = [{"train_seconds": x, "iteration": 100 * x, "psnr": y} for x, y in points]
    return pd.DataFrame(rows).assign(run=run)


def test_mean_and_interval_between_evaluations_at_different_seconds() -> None:
    both = pd.concat([curve([(1, 10), (3, 14), (5, 16)]), curve([(2, 20), (4, 20), (6, 20)], "b")])
    x, mean, half = mean_and_interval(both, "train_seconds", "psnr")
    assert x.tolist() == [2, 3, 4, 5]  # from where the second starts to where the first ends
    first = np.array([12, 14, 15, 16])  # by hand
    np.testing.assert_allclose(mean, (first + 20) / 2, rtol=1e-12)
    # Of two values s is their distance / √2, and t(1) at 97.5 % is tan(0.475 π): the t-distribution is Cauchy's.
    np.testing.assert_allclose(half, math.tan(0.475 * math.pi) * (20 - first) / 2, rtol=1e-9)


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
    recipes = curve_figures(collection)[0]
    svg = plot(collection, recipes)
    assert plot(collection, recipes) == svg
    ElementTree.fromstring(svg)
    for text in (
        "PSNR, dB, test views",
        "SSIM, test views",
        "loss, test views",
        "Gaussians",
        "training time, s",
        "iteration",
        "t-interval of the mean, of 3 seeds",
        "Dashed",
        "fast (train.batch=2)",
    ):
        assert text in svg, text
    paper = next(line for line in recipes.lines if line.recipe_label == "paper")
    assert "Dashed" not in plot(collection, CurveFigure("synthetic/wheel", "paper alone", (paper,)))


def test_dark_plots_have_the_colours_of_the_dark_theme_only(tmp_path: Path) -> None:
    collection = study(tmp_path)
    light = plot(collection, curve_figures(collection)[0])
    dark = recoloured(light, DARK)
    found = set(re.findall(r"#[0-9a-f]{6}", dark))
    assert {DARK.ink, DARK.faint, *DARK.lines[:4]} <= found
    assert not found & {LIGHT.ink, LIGHT.faint, *LIGHT.lines}
    assert recoloured(dark.replace(DARK.ink, LIGHT.ink), LIGHT) != light and len(dark) == len(light)


def test_quantity_that_was_not_measured_has_no_panel(tmp_path: Path) -> None:
    folder = write_run(tmp_path, "synthetic/wheel")
    rows = pd.read_csv(folder / "error_vs_time.csv").assign(ssim=None).drop(columns="test_loss")
    rows.to_csv(folder / "error_vs_time.csv", index=False)
    found = collect(tmp_path)
    assert len(found.curves) == 4 and not found.warnings
    text = plot(found, curve_figures(found)[0])
    assert "PSNR, dB" in text and "SSIM" not in text and "loss" not in text
