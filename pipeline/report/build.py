"""Builds all files of a report from a folder of runs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pipeline.presentation.table_files import files_of
from pipeline.presentation.theme import DARK
from pipeline.report.compare.curve_figures import curve_figures
from pipeline.report.tables.paper_tables import paper_tables
from pipeline.report.tables.run_tables import run_tables
from pipeline.report.tables.summary import summarise
from pipeline.report.write.html_page import render_page
from pipeline.report.write.image_strips import make_strips
from pipeline.report.write.plots import plot
from pipeline.report.write.run_figures import run_figures
from pipeline.report.write.sections import Content, CurvePlot, report_markdown, terminal_text
from pipeline.report.write.sfm_section import sfm_section
from pipeline.runs.read.collect import Collection, collect
from pipeline.runs.read.variants import name_variants


@dataclass(frozen=True)
class Report:
    """A report in memory."""

    files: dict[str, bytes]  # path below the output folder -> content
    warnings: tuple[str, ...]  # runs left out, and files of runs that could not be read
    terminal: str  # the summary and the tables that compare


def build_report(
    runs_dir: Path,
    no_pictures: tuple[str, ...] = (),
    levels: tuple[float, ...] = (),
    with_latex: bool = False,
    out: Path = Path(),
) -> Report:
    """The report of the runs below `runs_dir`; FileNotFoundError if there are none.

    no_pictures: scenes or families of scenes without images. levels: dB, of the table of training time to a PSNR.
    with_latex: whether to write each table as .tex too. out: the folder that the files will be in.
    """
    collection = name_variants(collect(runs_dir))
    strips, strip_warnings = make_strips(collection.runs, no_pictures)
    sfm, sfm_warnings = sfm_section(collection.runs, no_pictures)
    figures, figure_warnings = run_figures(collection.runs, no_pictures)
    summary = summarise(collection, strip_warnings + figure_warnings + sfm_warnings)
    content = Content(
        summary, paper_tables(collection), run_tables(collection, levels), sfm, strips, figures, _plots(collection)
    )
    files = _table_files(content, with_latex) | _image_files(content)
    files |= {"report.md": report_markdown(content).encode(), "report.html": render_page(content, out).encode()}
    return Report(files, (*summary.left_out, *summary.warnings), terminal_text(content))


def _plots(collection: Collection) -> list[CurvePlot]:
    return [
        CurvePlot(figure.title, figure.slug, plot(collection, figure), plot(collection, figure, DARK))
        for figure in curve_figures(collection)
    ]


def _table_files(content: Content, with_latex: bool) -> dict[str, bytes]:
    return {
        f"tables/{name}": written for table in content.tables for name, written in files_of(table, with_latex).items()
    }


def _image_files(content: Content) -> dict[str, bytes]:
    files = {f"plots/{plot.slug}.svg": plot.light.encode() for plot in content.plots}
    files |= {f"strips/{strip.filename}": strip.webp for strip in content.strips}
    files |= {f"strips/{figure.filename}": figure.webp for figure in content.figures}
    if content.sfm:
        files |= {f"strips/{picture.filename}": picture.webp for picture in content.sfm.pictures}
    return files
