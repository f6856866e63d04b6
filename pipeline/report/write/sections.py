"""The sections of a report in order, and their text in report.md and on the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from pipeline.presentation.table import Table
from pipeline.presentation.table_files import markdown
from pipeline.report.tables.changed_settings import STUDY
from pipeline.report.tables.summary import Summary, summary_markdown
from pipeline.report.write.image_strips import Strip
from pipeline.report.write.run_figures import RunFigure
from pipeline.report.write.sfm_section import SfmSection

Picture = TypeVar("Picture", Strip, RunFigure)

URBAN = "urban"  # prefix of the slugs of driving logs
_RUN_TABLES = ("all_runs", "provenance")  # slugs
TITLES = {
    "summary": "Summary",
    "strips": "Held-out views",
    "figures": "Motion and time",
    "curves": "Learning curves",
    "ablations": "Ablations",
    "paper": "The paper's tables with our results",
    "scenes": "Results per scene",
    "comparisons": "Schedules and batches",
    "sfm": "Structure from motion",
    "raw": "All runs",
}


@dataclass(frozen=True)
class CurvePlot:
    """One figure in both themes, as SVG text."""

    title: str
    slug: str  # its file name without suffix
    light: str
    dark: str


@dataclass(frozen=True)
class Content:
    """Everything in a report. Parts without runs are empty."""

    summary: Summary
    paper: Sequence[Table]  # the paper's tables with our rows
    ours: Sequence[Table]  # other tables
    sfm: SfmSection | None
    strips: Sequence[Strip]
    figures: Sequence[RunFigure]  # of pipeline.figures, where it was called
    plots: Sequence[CurvePlot]

    @property
    def tables(self) -> list[Table]:
        return [*self.ablations, *self.paper, *self.scenes, *self.comparisons, *self.sfm_tables, *self.raw]

    @property
    def ablations(self) -> list[Table]:
        return [table for table in self.ours if table.slug == "ablation_verdicts"]

    @property
    def scenes(self) -> list[Table]:
        return [table for table in self.ours if table.slug.startswith("scenes_")]

    @property
    def comparisons(self) -> list[Table]:
        """Tables that compare schedules, batches and changed settings: all that no other section has."""
        elsewhere = {table.slug for table in (*self.ablations, *self.scenes, *self.raw)}
        return [table for table in self.ours if table.slug not in elsewhere]

    @property
    def sfm_tables(self) -> list[Table]:
        return [self.sfm.table] if self.sfm else []

    @property
    def raw(self) -> list[Table]:
        """Tables with one row per run."""
        return [table for table in self.ours if table.slug in _RUN_TABLES]

    @property
    def strips_by_scene(self) -> list[list[Strip]]:
        return _by_scene(self.strips)

    @property
    def figures_by_scene(self) -> list[list[RunFigure]]:
        return _by_scene(self.figures)


def _by_scene(pictures: Sequence[Picture]) -> list[list[Picture]]:
    groups: dict[str, list[Picture]] = {}
    for picture in pictures:
        groups.setdefault(picture.scene, []).append(picture)
    return list(groups.values())


def report_markdown(content: Content) -> str:
    """report.md."""
    pictures = content.sfm.pictures if content.sfm else ()
    sections = {
        "strips": [
            f"![{s.scene}, {s.train}, {s.ablation}: {s.view}, {s.choice_text}](strips/{s.filename})\n"
            for s in content.strips
        ],
        "figures": [
            f"**{f.scene}, {f.title}.** {f.seen}\n\n![{f.title} of {f.scene}](strips/{f.filename})\n"
            for f in content.figures
        ],
        "curves": [f"![{p.title}](plots/{p.slug}.svg)\n" for p in content.plots],
        "ablations": _markdown(content.ablations),
        "paper": _markdown(content.paper),
        "scenes": _markdown(content.scenes),
        "comparisons": _markdown(content.comparisons),
        "sfm": [
            *_markdown(content.sfm_tables),
            *(f"![points and cameras of {p.scene}](strips/{p.filename})\n" for p in pictures),
        ],
        "raw": _markdown(content.raw),
    }
    lines = ["# Benchmark report\n", summary_markdown(content.summary)]
    for key, section in sections.items():
        lines += [f"## {TITLES[key]}\n", *section] if section else []
    return "\n".join(lines)


def terminal_text(content: Content) -> str:
    """The summary and the tables that compare models, scenes and settings."""
    compared = [
        table for table in content.comparisons if table.slug == "batches" or table.slug.startswith((STUDY, URBAN))
    ]
    tables = [*content.ablations, *content.paper, *content.scenes, *compared, *content.sfm_tables]
    return "\n".join([summary_markdown(content.summary), *_markdown(tables)])


def _markdown(tables: Iterable[Table]) -> list[str]:
    return [markdown(table) for table in tables]
