"""What is in a report, in sections, and its text in report.md and on the terminal."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import pandas as pd

from pipeline.presentation.table import NO_RUN, NOTHING, Row, Table
from pipeline.presentation.table_files import markdown
from pipeline.report.runs import BEST, FINAL, GIVEN
from pipeline.report.scenes import FULL
from pipeline.report.strips import RunFigure, Strip

TITLES = {
    "leaderboards": "Leaderboards",
    "summary": "Summary",
    "strips": "Held-out views",
    "figures": "Motion and time",
    "curves": "Learning curves",
    "ablations": "Ablations",
    "paper": "The paper's tables with our results",
    "scenes": "Results per scene",
    "comparisons": "Recipes and settings",
    "sfm": "Structure from motion",
    "raw": "All runs",
}
_COMMIT = 10  # characters of a commit hash; the table of provenance has all


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

    runs: pd.DataFrame
    left_out: Sequence[str]
    warnings: Sequence[str]
    tables: Sequence[Table]
    strips: Sequence[Strip]
    figures: Sequence[RunFigure]  # of pipeline.figures, where it was called
    plots: Sequence[CurvePlot]
    sfm_pictures: Sequence[RunFigure]

    def of(self, section: str) -> list[Table]:
        return [table for table in self.tables if table.section == section]

    @property
    def sections(self) -> dict[str, str]:
        """id -> title of the sections that are not empty, in order."""
        other = {"summary": True, "strips": self.strips, "figures": self.figures, "curves": self.plots}
        return {key: title for key, title in TITLES.items() if other.get(key) or self.of(key)}

    @property
    def facts(self) -> list[str]:
        dates = sorted(date[:10] for date in self.runs["date"] if date != "unknown")
        # A commit hash is shortened; a suffix (-dirty) is kept.
        commits = {re.sub(rf"^([0-9a-f]{{{_COMMIT}}})[0-9a-f]*", r"\1", commit) for commit in self.runs["git_commit"]}
        return [
            f"{len(self.runs)} run{'s' if len(self.runs) != 1 else ''}",
            " to ".join(dict.fromkeys((dates[0], dates[-1]))) if dates else "date unknown",
            "; ".join(sorted(set(self.runs["machine"]))),
            f"commit {', '.join(sorted(commits))}",
        ]

    @property
    def headlines(self) -> list[dict[str, str]]:
        """Of every scene and recipe the row of the full model in the tables of scenes; of others where it has none."""
        rows = [row for table in self.of("scenes") for row in table.rows]
        with_full = {_shown(row, "scene_label") for row in rows if _shown(row, "model") == FULL}
        return [
            {
                "scene": _shown(row, "scene_label"),
                "name": _shown(row, "recipe_label")
                + ("" if model in (FULL, GIVEN) else f", {model}")
                + (", images given" if _shown(row, "images") == GIVEN else ""),
                "seeds": _shown(row, "seeds"),
                "psnr": _shown(row, f"{FINAL}.psnr"),
                "best": _shown(row, f"{BEST}.psnr"),
                "seconds": _shown(row, "train_seconds"),
            }
            for row in rows
            if (model := _shown(row, "model")) in (FULL, GIVEN) or _shown(row, "scene_label") not in with_full
        ]

    @property
    def verdicts(self) -> list[dict[str, str]]:
        """Of every ablation with a baseline, by final PSNR."""
        return [
            {
                "model": _shown(row, "model"),
                "scene": _shown(row, "scene_label"),
                "recipe": _shown(row, "recipe_label"),
                "word": _shown(row, f"{FINAL}.psnr.verdict"),
                "difference": row.cells[f"{FINAL}.psnr.difference"].text,
            }
            for table in self.of("ablations")
            for row in table.rows
            if row.cells.get(f"{FINAL}.psnr.difference", NOTHING) != NOTHING
        ]

    @property
    def strips_by_scene(self) -> list[list[Strip]]:
        return [list(of_scene) for _, of_scene in groupby(self.strips, lambda strip: strip.scene)]

    @property
    def figures_by_scene(self) -> list[list[RunFigure]]:
        return [list(of_scene) for _, of_scene in groupby(self.figures, lambda figure: figure.scene)]


def _shown(row: Row, key: str) -> str:
    return row.cells.get(key, NO_RUN).text


def summary_markdown(content: Content) -> str:
    lines = [f"{'; '.join(content.facts)}.", ""]
    lines += [
        f"- **{h['scene']}**, {h['name']}: {h['psnr']} dB final, {h['best']} dB best on test, "
        f"{h['seconds']} s training, {h['seeds']} seed{'s' if h['seeds'] != '1' else ''}"
        for h in content.headlines
    ]
    lines += [
        f"- {v['model']} on {v['scene']}: {v['word']}, {v['difference']} dB ({v['recipe']})" for v in content.verdicts
    ]
    return "\n".join([*lines, *(f"- {line}" for line in (*content.left_out, *content.warnings))]) + "\n"


def report_markdown(content: Content) -> str:
    pictures = {
        "strips": [
            f"![{s.scene}, {s.recipe_label}, {s.model}: {s.view}, {s.choice_text}](strips/{s.filename})\n"
            for s in content.strips
        ],
        "figures": [
            f"**{f.scene}, {f.title}.** {f.seen}\n\n![{f.title} of {f.scene}](strips/{f.filename})\n"
            for f in content.figures
        ],
        "curves": [f"![{p.title}](plots/{p.slug}.svg)\n" for p in content.plots],
        "sfm": [f"![{p.title} of {p.scene}](strips/{p.filename})\n" for p in content.sfm_pictures],
    }
    lines = ["# Benchmark report\n", summary_markdown(content)]
    for key, title in content.sections.items():
        if key != "summary":
            lines += [f"## {title}\n", *map(markdown, content.of(key)), *pictures.get(key, [])]
    return "\n".join(lines)


def terminal_text(content: Content) -> str:
    """The summary and the tables that compare models, scenes and settings; the ablations last."""
    shown = ("paper", "scenes", "comparisons", "sfm", "ablations")
    return "\n".join([summary_markdown(content), *(markdown(table) for key in shown for table in content.of(key))])
