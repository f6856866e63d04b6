"""`python -m pipeline.report RUNS_DIR [--out DIR]`: tables (md, csv, tex), plots, strips, one page.

Exit status 1 with one line when there is nothing to report. A run that can't be read does not stop the
others: it is named on standard error and in the report, and the exit status stays 0.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from .collect import collect
from .comparisons import comparisons
from .export import markdown, write_all
from .page import CurvePlot, render_page
from .plots import DARK, plot
from .run_tables import run_tables
from .strips import make_strips
from .structure import Structure, structure_from_motion
from .study import STUDY
from .summary import summarise, summary_markdown
from .tables import paper_tables
from .variants import name_variants


def main(arguments: list[str] | None = None) -> int:
    """The command; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m pipeline.report", description="Tables, plots and one HTML page from a folder of runs."
    )
    parser.add_argument("runs_dir", type=Path, metavar="RUNS_DIR")
    parser.add_argument("--out", type=Path, metavar="DIR", help="default: RUNS_DIR/../report")
    parser.add_argument("--no-pictures", nargs="*", default=[], metavar="SCENE",
                        help="scenes, or families of them (dnerf), whose images may not be passed on: no strips")
    parser.add_argument("--psnr", nargs="*", type=float, default=[], metavar="DB",
                        help="levels of the table of training seconds to a PSNR (default: by scene)")
    options = parser.parse_args(arguments)
    try:
        out = options.out or options.runs_dir.resolve().parent / "report"
        write_report(options.runs_dir, out, tuple(options.no_pictures), tuple(options.psnr))
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def write_report(runs_dir: Path, out: Path, no_pictures: tuple[str, ...] = (), levels: tuple[float, ...] = ()) -> None:
    """Reads `runs_dir`, writes everything under `out`, prints the summary and the tables that compare.

    no_pictures: scenes or families of scenes without strips and without a picture of their points. levels: dB, of the
    table of seconds to a PSNR.
    """
    collection = name_variants(collect(runs_dir))
    strips, strip_warnings = make_strips(collection.runs, no_pictures)
    structure, structure_warnings = structure_from_motion(collection.runs, no_pictures)
    summary = summarise(collection, strip_warnings + structure_warnings)
    for line in (*summary.left_out, *summary.warnings):
        print(f"warning: {line}", file=sys.stderr)

    of_paper, ours = paper_tables(collection.runs), run_tables(collection, levels)
    plots = [
        CurvePlot(compared.title, compared.slug, plot(collection, compared), plot(collection, compared, DARK))
        for compared in comparisons(collection)
    ]

    _clear(out)
    of_points = [structure.table] if structure else []
    for table in (*of_paper, *ours, *of_points):
        write_all(table, out / "tables")
    pictures = (*strips, *(structure.pictures if structure else ()))
    for name, content in [
        (f"plots/{of_curves.slug}.svg", of_curves.light.encode()) for of_curves in plots
    ] + [(f"strips/{picture.filename}", picture.webp) for picture in pictures]:
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_bytes(content)
    verdicts, *others = ours
    curves = "\n".join(f"![{p.title}](plots/{p.slug}.svg)\n" for p in plots)
    (out / "report.md").write_text(
        "\n".join(
            [
                "# Benchmark report\n",
                summary_markdown(summary),
                "## Training curves\n",
                curves,
                *_structure_markdown(structure),
                "## Tables\n",
                *(markdown(table) for table in (verdicts, *of_paper, *others)),
            ]
        ),
        encoding="utf-8",
    )
    page = render_page(summary, of_paper, ours, plots, strips, structure)
    (out / "report.html").write_text(page, encoding="utf-8")

    print(summary_markdown(summary))
    shown = [table for table in others if table.slug.startswith(("scenes_", STUDY)) or table.slug == "batches"]
    for table in (verdicts, *of_paper, *shown, *of_points):
        print(markdown(table))
    print(f"Page: {out / 'report.html'}   tables: {out / 'tables'}   plots: {out / 'plots'}")


def _structure_markdown(structure: Structure | None) -> list[str]:
    """A section of report.md; nothing where no run started from structure from motion."""
    if structure is None:
        return []
    pictures = [f"![points and cameras of {p.scene}](strips/{p.filename})\n" for p in structure.pictures]
    return ["## Structure from motion\n", markdown(structure.table), *pictures]


def _clear(out: Path) -> None:
    """Removes what an earlier report wrote here, so that no picture of a deleted run stays behind."""
    if not (out / "report.html").is_file():
        return  # not ours: touch nothing
    for pattern in (
        "tables/*.md",
        "tables/*.csv",
        "tables/*.tex",
        "plots/*.svg",
        "strips/*.webp",
        "report.*",
    ):
        for path in out.glob(pattern):
            path.unlink()


if __name__ == "__main__":
    sys.exit(main())
