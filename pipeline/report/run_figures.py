"""The figures that `python -m pipeline.figures` wrote into run folders: optical flow, lifetimes, slices, new views.

Shown is one run a scene: of the recipe and the model whose views are shown too, or else the first with figures.
"""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from datasets.files.errors import DataError, clear, read_json
from pipeline.report import scenes
from pipeline.report.strips import RunFigure, compose, opened, shown_experiment, webp_name

FOLDER, INDEX = "figures", "figures.json"  # of a run folder, as pipeline/figures writes them
_MAX_SIDE = 1200  # pixels


def run_figures(runs: pd.DataFrame, no_pictures: tuple[str, ...] = ()) -> tuple[list[RunFigure], list[str]]:
    """The figures in the order of the scenes, and a warning for each that could not be read."""
    found, warnings = [], []
    for scene in scenes.in_order(runs["scene"]):
        of_scene = runs[runs["scene"] == scene]
        with_figures = of_scene[[(Path(folder) / FOLDER / INDEX).is_file() for folder in of_scene["folder"]]]
        if with_figures.empty or scenes.is_excluded(scene, no_pictures):
            continue
        recipe, model = shown_experiment(of_scene)
        preferred = with_figures[(with_figures["recipe_label"] == recipe) & (with_figures["model"] == model)]
        run = (with_figures if preferred.empty else preferred).sort_values("seed").iloc[0]
        try:
            found += _figures(scene, run["run"], Path(run["folder"]) / FOLDER)
        except Exception as error:  # PIL raises many types for damaged files
            warnings.append(f"{run['run']}: no figures: {clear(error)}")
    return found, warnings


def _figures(scene: str, run: str, folder: Path) -> list[RunFigure]:
    """Raises whatever PIL raises for missing and damaged images, and DataError."""
    listed = read_json(folder / INDEX)
    if not isinstance(listed, list):
        raise DataError(folder / INDEX, "a list of figures", type(listed).__name__)
    figures = []
    for row in listed:
        keys = ("file", "title", "seen")
        if not isinstance(row, dict) or not all(isinstance(row.get(key), str) for key in keys):
            raise DataError(folder / INDEX, "file, title and seen of each figure", f"{row}")
        name = Path(row["file"]).name
        filename = webp_name(scene, FOLDER, Path(name).stem)
        webp = compose([opened(folder / name)], _MAX_SIDE)
        figures.append(RunFigure(scene, run, clear(row["title"]), clear(row["seen"]), filename, webp))
    return figures
