"""Training curves: which runs stand in one figure, and what a line of it shows."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from report_runs import write_run

from pipeline.presentation.theme import DARK
from pipeline.report.compare.bands import band, end_of_coarse, split_at
from pipeline.report.compare.comparisons import Comparison, comparisons
from pipeline.report.write.plots import plot
from pipeline.runs.read.collect import Collection, collect
from pipeline.runs.read.variants import name_variants

FAST = {"batch": "1", "optimiser": "sparse_adam", "resolution_steps": "[{until: 0.5, scale: 0.5}]", "init_points": "20"}


def write_variant(root: Path, name: str, ablation: str = "full", train: str = "fast", **changes) -> None:
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
            out=f"{name}/seed{seed}",
        )


def study(root: Path) -> Collection:
    """What conf/experiment/training_curves.yaml makes, in small."""
    write_variant(root, "adam", optimiser="adam")
    write_variant(root, "batch2", batch="2")
    write_variant(root, "batch4", batch="4")
    write_variant(root, "fast")
    write_variant(root, "full_size", resolution_steps="[]")
    write_variant(root, "no_4drot", ablation="no_4drot")
    write_variant(root, "paper", train="paper", batch="4", optimiser="adam", resolution_steps="[]", init_points="100")
    return name_variants(collect(root))


def lines_of(found: list[Comparison]) -> dict[str, list[str]]:
    return {comparison.title: [line.label for line in comparison.lines] for comparison in found}


# --- which runs stand in one figure ----------------------------------------------------------------------------------


def test_a_figure_for_each_thing_that_varies(tmp_path: Path) -> None:
    coarse = "fast (resolution_steps=[])"
    assert lines_of(comparisons(study(tmp_path))) == {
        "synthetic/wheel: schedule": ["fast", "paper"],
        "synthetic/wheel: batch": ["fast", "fast (batch=2)", "fast (batch=4)"],
        "synthetic/wheel: resolution": ["fast", coarse],
        "synthetic/wheel: optimiser": ["fast", "fast (optimiser=adam)"],
        "synthetic/wheel: ablation, fast": ["full", "no_4drot"],
    }


def test_each_schedule_with_its_ablations(tmp_path: Path) -> None:
    for train in ("fast", "paper"):
        for ablation in ("full", "no_4drot"):
            write_run(tmp_path, "synthetic/wheel", ablation, train)
    assert lines_of(comparisons(collect(tmp_path))) == {
        "synthetic/wheel: ablation, fast": ["full", "no_4drot"],
        "synthetic/wheel: ablation, paper": ["full", "no_4drot"],
    }


def test_no_line_is_lost_and_none_stands_beside_another_scene(tmp_path: Path) -> None:
    write_run(tmp_path, "synthetic/lamp")
    write_run(tmp_path, "synthetic/wheel")
    write_run(tmp_path, "synthetic/wheel", train="paper")
    (write_run(tmp_path, "synthetic/wheel", train="mine") / "config.yaml").unlink()
    found = collect(tmp_path)
    assert lines_of(comparisons(found)) == {
        "synthetic/wheel: schedule": ["fast", "paper"],
        "synthetic/wheel: mine": ["mine"],
        "synthetic/lamp: fast": ["fast"],
    }


def test_titles_and_file_names_are_unique(tmp_path: Path) -> None:
    for batch in (1, 4):
        for sampler in ("pairs", "views_at_one_time"):
            write_variant(tmp_path, f"{sampler}{batch}", batch=str(batch), sampler=sampler)
    found = comparisons(name_variants(collect(tmp_path)))
    assert len({c.slug for c in found}) == len({c.title for c in found}) == len(found) == 4
    assert all(re.fullmatch(r"[\w.-]+", c.slug) for c in found)


def test_usual_settings_are_those_that_the_others_are_variants_of(tmp_path: Path) -> None:
    """As many runs of each variant as of what they are variants of: none is the most common."""
    assert sorted(set(study(tmp_path).runs["train"])) == [
        "fast",
        "fast (batch=2)",
        "fast (batch=4)",
        "fast (optimiser=adam)",
        "fast (resolution_steps=[])",
        "paper",
    ]


def test_what_all_lines_share_stands_in_the_title_alone(tmp_path: Path) -> None:
    for batch in (1, 4):
        write_variant(tmp_path, f"batch{batch}", batch=str(batch))
        for seed in range(2):
            path = tmp_path / f"batch{batch}/seed{seed}/environment.json"
            typed = f"train.batch={batch} 'train.fourier_at=[1, 2]'"
            path.write_text(path.read_text().replace(" seed=", f" {typed} seed="))
    assert lines_of(comparisons(name_variants(collect(tmp_path)))) == {
        "synthetic/wheel: batch, fourier_at=[1, 2]": ["fast (batch=1)", "fast (batch=4)"]
    }


# --- what a line shows -----------------------------------------------------------------------------------------------


def curve(points: list[tuple[float, float]], run: str = "a") -> pd.DataFrame:
    rows = [{"train_seconds": x, "iteration": 100 * x, "psnr": y} for x, y in points]
    return pd.DataFrame(rows).assign(run=run)


def test_mean_and_std_between_evaluations_at_different_seconds() -> None:
    both = pd.concat([curve([(1, 10), (3, 14), (5, 16)]), curve([(2, 20), (4, 20), (6, 20)], "b")])
    x, mean, std = band(both, "train_seconds", "psnr")
    assert x.tolist() == [2, 3, 4, 5]  # from where the second starts to where the first ends
    first = np.array([12, 14, 15, 16])  # by hand
    np.testing.assert_allclose(mean, (first + 20) / 2, rtol=1e-12)
    np.testing.assert_allclose(std, (20 - first) / math.sqrt(2), rtol=1e-12)  # of two values: their distance / √2


def test_where_training_reaches_the_full_resolution() -> None:
    steps = [{"until": 0.15, "scale": 0.25}, {"until": 0.5, "scale": 0.5}]
    both = pd.concat([curve([(2, 1), (8, 1), (10, 1)]), curve([(4, 1), (6, 1), (10, 1)], "b")])
    settings = {run: {"train.iterations": 1000, "train.resolution_steps": steps} for run in "ab"}
    assert end_of_coarse(both, settings, "iteration") == pytest.approx(500)
    assert end_of_coarse(both, settings, "train_seconds") == pytest.approx(5)
    # With 5 s to train, the schedule is half through after 2.5 s, whatever the iteration.
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
def test_a_line_is_cut_in_two_that_meet(at: float, before: list[float], after: list[float]) -> None:
    xs = np.array([1.0, 2.0, 3.0])
    parts = split_at(xs, 10 * xs, at)
    for (x, y), expected in zip(parts, (before, after)):
        assert x.tolist() == expected and y.tolist() == [10 * value for value in expected]


# --- the figure ------------------------------------------------------------------------------------------------------


def test_the_figure_says_what_it_shows(tmp_path: Path) -> None:
    found = study(tmp_path)
    of = {comparison.title: comparison for comparison in comparisons(found)}
    shown = of["synthetic/wheel: resolution"]
    text = plot(found, shown)
    assert plot(found, shown) == text != plot(found, shown, DARK)
    ElementTree.fromstring(text)
    for said in (
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
        assert said in text, said  # drawn as outlines, with the words in a comment
    assert "Dashed" not in plot(
        found,
        Comparison(
            "synthetic/wheel",
            "paper alone",
            (next(line for line in of["synthetic/wheel: schedule"].lines if line.train == "paper"),),
        ),
    )


def test_a_quantity_that_was_not_measured_has_no_panel(tmp_path: Path) -> None:
    folder = write_run(tmp_path, "synthetic/wheel")
    rows = pd.read_csv(folder / "error_vs_time.csv").assign(ssim=None).drop(columns="test_loss")
    rows.to_csv(folder / "error_vs_time.csv", index=False)
    found = collect(tmp_path)
    assert len(found.curves) == 4 and not found.warnings
    text = plot(found, comparisons(found)[0])
    assert "PSNR, dB" in text and "SSIM" not in text and "loss" not in text
