"""What a report holds, in reading order, and its two texts: report.md and what the command prints."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from pipeline.presentation.table import Table
from pipeline.presentation.table_files import markdown
from pipeline.report.tables.summary import Summary, summary_markdown
from pipeline.report.tables.variants_study import STUDY
from pipeline.report.write.strips import Strip
from pipeline.report.write.structure import Structure

_COMPARISONS = ("equal_time", "time_to_psnr", "batches")  # slugs of tables that set schedules side by side
_RAW = ("all_runs", "provenance")


@dataclass(frozen=True)
class CurvePlot:
    """One figure in both themes, as SVG text."""

    title: str
    slug: str  # names its file
    light: str
    dark: str


@dataclass(frozen=True)
class Content:
    """Everything, made but not written. What there are no runs for is empty."""

    summary: Summary
    paper: Sequence[Table]  # the paper's tables, ours beside
    ours: Sequence[Table]
    structure: Structure | None
    strips: Sequence[Strip]
    plots: Sequence[CurvePlot]

    @property
    def tables(self) -> list[Table]:
        return [*self.ablations, *self.paper, *self.scenes, *self.comparisons, *self.of_points, *self.raw]

    @property
    def ablations(self) -> list[Table]:
        return [table for table in self.ours if table.slug == "ablation_verdicts"]

    @property
    def scenes(self) -> list[Table]:
        return [table for table in self.ours if table.slug.startswith("scenes_")]

    @property
    def comparisons(self) -> list[Table]:
        return [table for table in self.ours if table.slug in _COMPARISONS or table.slug.startswith(STUDY)]

    @property
    def of_points(self) -> list[Table]:
        return [self.structure.table] if self.structure else []

    @property
    def raw(self) -> list[Table]:
        """Every run by itself."""
        return [table for table in self.ours if table.slug in _RAW]

    @property
    def groups(self) -> list[list[Strip]]:
        """The strips of each scene and schedule."""
        groups: dict[tuple[str, str], list[Strip]] = {}
        for strip in self.strips:
            groups.setdefault((strip.scene, strip.train), []).append(strip)
        return list(groups.values())


def report_markdown(content: Content) -> str:
    """report.md."""
    sections = (
        (
            "Pictures",
            [
                f"![{s.scene}, {s.train}, {s.ablation}: {s.view}, {s.said}](strips/{s.filename})\n"
                for s in content.strips
                if s.of == s.ablation
            ],
        ),
        ("Training curves", [f"![{p.title}](plots/{p.slug}.svg)\n" for p in content.plots]),
        ("Ablations", _markdown(content.ablations)),
        ("The paper's tables, ours beside", _markdown(content.paper)),
        ("Scene by scene", _markdown(content.scenes)),
        ("Schedules and batches", _markdown(content.comparisons)),
        (
            "Structure from motion",
            [
                *_markdown(content.of_points),
                *(
                    f"![points and cameras of {p.scene}](strips/{p.filename})\n"
                    for p in (content.structure.pictures if content.structure else ())
                ),
            ],
        ),
        ("Raw numbers", _markdown(content.raw)),
    )
    return "\n".join(
        [
            "# Benchmark report\n",
            summary_markdown(content.summary),
            *(line for title, lines in sections if lines for line in (f"## {title}\n", *lines)),
        ]
    )


def terminal_text(content: Content) -> str:
    """The summary and the tables that compare."""
    compared = [table for table in content.comparisons if table.slug == "batches" or table.slug.startswith(STUDY)]
    return "\n".join(
        [
            summary_markdown(content.summary),
            *_markdown([*content.ablations, *content.paper, *content.scenes, *compared, *content.of_points]),
        ]
    )


def _markdown(tables: Iterable[Table]) -> list[str]:
    return [markdown(table) for table in tables]
