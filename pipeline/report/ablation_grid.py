"""Ablations in the layout of the paper's Table 3: a row each, two columns a scene, and their averages."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from pipeline.presentation.table import NO_RUN, Cell, Column, Row, Table
from pipeline.report import scenes
from pipeline.report.run_table import Shown, missing_notes, protocol_notes
from pipeline.report.runs import RENDERED, Collection

METRICS_SHOWN = ("psnr", "ssim")


@dataclass(frozen=True)
class AblationGrid:
    """Of the scenes and recipes of a family with two of the paper's ablations or more."""

    slug: str
    title: str
    family: str
    section: str = "ablations"

    def build(self, collection: Collection) -> Table | None:
        runs = collection.runs
        runs = runs[(runs["images"] == RENDERED) & runs["model"].isin(scenes.ABLATIONS)]
        of_family = [scenes.family(*row) == self.family for row in zip(runs["scene"], runs["capture"])]
        runs = runs[of_family]
        several = runs.groupby(["scene_label", "recipe_label", "protocol"])["model"].transform("nunique") > 2
        runs = runs[several]
        if runs.empty:
            return None
        labels = scenes.in_order(runs["scene_label"])
        rows = []
        for (recipe, protocol), of_recipe in runs.groupby(["recipe_label", "protocol"], sort=True):
            wanted = set(of_recipe["scene_label"])
            for model in scenes.ABLATIONS:
                found = of_recipe[of_recipe["model"] == model]
                cells = {"recipe_label": Cell(str(recipe)), "protocol": Cell(str(protocol)), "model": Cell(model)}
                for key in METRICS_SHOWN:
                    for label in labels:
                        one = found[found["scene_label"] == label]
                        cells[f"{scenes.short(label)}_{key}"] = NO_RUN if one.empty else Shown(key).cell(one)
                    whole = set(found["scene_label"]) == wanted
                    cells[f"mean_{key}"] = Shown(key).cell(found) if whole else NO_RUN
                rows.append(Row(cells))
        notes = [
            *protocol_notes(runs["protocol"]),
            "Each number is the mean over the seeds that were run; the average is over the scenes.",
            *missing_notes(runs, METRICS_SHOWN),
        ]
        return Table(
            self.slug,
            self.title,
            (*_heads(), *_columns(labels)),
            tuple(rows),
            notes=tuple(("", note) for note in notes),
            over_seeds=True,
            section=self.section,
        )


def _heads() -> Iterable[Column]:
    yield Column("model", "Ablation", False)
    yield Column("recipe_label", "Recipe", False, fold=True)
    yield Column("protocol", "Protocol", False, fold=True)


def _columns(labels: list[str]) -> Iterable[Column]:
    for label in (*labels, ""):
        for key in METRICS_SHOWN:
            name = scenes.short(label) if label else "mean"
            yield Column(f"{name}_{key}", f"{name if label else 'average'} {key.upper()} ↑")
