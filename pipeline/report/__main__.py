"""`python -m pipeline.report RUNS_DIR [--out DIR]`: tables (md, csv, tex), plots, strips, one page.

Exit status 1 with one line when there is nothing to report. A run that can't be read does not stop the
others: it is named on standard error and in the report, and the exit status stays 0. Files are written before
anything is printed.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

from pipeline.presentation.table_files import files_of
from pipeline.presentation.theme import DARK
from pipeline.report.compare.comparisons import comparisons
from pipeline.report.tables.paper_tables import paper_tables
from pipeline.report.tables.run_tables import run_tables
from pipeline.report.tables.summary import summarise
from pipeline.report.write.content import Content, CurvePlot, report_markdown, terminal_text
from pipeline.report.write.out_folder import replace_report
from pipeline.report.write.page import render_page
from pipeline.report.write.plots import plot
from pipeline.report.write.strips import make_strips
from pipeline.report.write.structure import structure_from_motion
from pipeline.runs.read.collect import collect
from pipeline.runs.read.variants import name_variants
from pipeline.terminal.closed_pipe import quiet_on_closed_pipe


@quiet_on_closed_pipe()
def main(arguments: list[str] | None = None) -> int:
    """The command; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m pipeline.report", description="Tables, plots and one HTML page from a folder of runs."
    )
    parser.add_argument("runs_dir", type=Path, metavar="RUNS_DIR")
    parser.add_argument("--out", type=Path, metavar="DIR", help="default: RUNS_DIR/../report")
    parser.add_argument(
        "--no-pictures",
        nargs="*",
        default=[],
        metavar="SCENE",
        help="scenes, or families of them (dnerf), whose images may not be passed on: no strips",
    )
    parser.add_argument(
        "--psnr",
        nargs="*",
        type=float,
        default=[],
        metavar="DB",
        help="levels of the table of training seconds to a PSNR (default: by scene)",
    )
    options = parser.parse_args(arguments)
    out = options.out or options.runs_dir.resolve().parent / "report"
    try:
        report = make_report(options.runs_dir, tuple(options.no_pictures), tuple(options.psnr))
        replace_report(out, report.files)
        for line in report.warnings:
            print(f"warning: {line}", file=sys.stderr)
        print(report.terminal)
        print(f"Page: {out / 'report.html'}   tables: {out / 'tables'}   plots: {out / 'plots'}", flush=True)
    except BrokenPipeError:
        raise
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


@dataclass(frozen=True)
class Report:
    """All of it, not yet written."""

    files: dict[str, bytes]  # path below the report's folder -> content
    warnings: tuple[str, ...]  # runs left out, and parts of runs
    terminal: str  # the summary and the tables that compare


def make_report(runs_dir: Path, no_pictures: tuple[str, ...] = (), levels: tuple[float, ...] = ()) -> Report:
    """The report of the runs under `runs_dir`; FileNotFoundError, one line, if there is none.

    no_pictures: scenes or families of scenes without strips and without a picture of their points. levels: dB, of the
    table of seconds to a PSNR.
    """
    collection = name_variants(collect(runs_dir))
    strips, strip_warnings = make_strips(collection.runs, no_pictures)
    structure, structure_warnings = structure_from_motion(collection.runs, no_pictures)
    summary = summarise(collection, strip_warnings + structure_warnings)
    content = Content(
        summary,
        paper_tables(collection),
        run_tables(collection, levels),
        structure,
        strips,
        [
            CurvePlot(compared.title, compared.slug, plot(collection, compared), plot(collection, compared, DARK))
            for compared in comparisons(collection)
        ],
    )
    files: dict[str, bytes] = {}
    for table in content.tables:
        files |= {f"tables/{name}": written for name, written in files_of(table).items()}
    files |= {f"plots/{of_curves.slug}.svg": of_curves.light.encode() for of_curves in content.plots}
    files |= {
        f"strips/{picture.filename}": picture.webp for picture in (*strips, *(structure.pictures if structure else ()))
    }
    files |= {"report.md": report_markdown(content).encode(), "report.html": render_page(content).encode()}
    return Report(files, (*summary.left_out, *summary.warnings), terminal_text(content))


if __name__ == "__main__":
    sys.exit(main())
