"""Builds all files of a report from folders of runs."""

from __future__ import annotations

import base64
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from urllib.parse import quote

import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from pipeline.presentation.table import Table
from pipeline.presentation.table_files import files_of
from pipeline.presentation.table_layout import laid_out
from pipeline.presentation.theme import DARK
from pipeline.report import tables
from pipeline.report.content import Content, CurvePlot, report_markdown, terminal_text
from pipeline.report.curve_figures import curve_figures, file_name
from pipeline.report.mean_curves import with_means
from pipeline.report.nerfbaselines import result_file
from pipeline.report.plots import plot, recoloured
from pipeline.report.runs import Collection, collect
from pipeline.report.sfm import sfm_section
from pipeline.report.strips import RunFigure, Strip, make_strips, run_figures
from pipeline.report.time_to_psnr import TimeToPsnr
from pipeline.report.time_to_target import TimeToTarget


@dataclass(frozen=True)
class Report:
    files: dict[str, bytes]  # path below the output folder -> content
    warnings: tuple[str, ...]  # runs left out, and files of runs that could not be read
    terminal: str  # the summary and the tables that compare


def build_report(
    roots: Sequence[Path],
    no_pictures: tuple[str, ...] = (),
    levels: tuple[float, ...] = (),
    with_latex: bool = False,
    out: Path = Path(),
    for_nerfbaselines: bool = False,
) -> Report:
    """The report of the runs below `roots`; FileNotFoundError if there are none.

    no_pictures: scenes or families of scenes without images. levels: dB, of the table of training time to a PSNR.
    with_latex: whether to write each table as .tex too. out: the folder that the files will be in. for_nerfbaselines:
    whether to write each run as a result file of NerfBaselines.
    """
    collection = collect(*roots)
    content = content_of(collection, no_pictures, levels, plots_of(collection))
    files = {f"tables/{name}": data for table in content.tables for name, data in files_of(table, with_latex).items()}
    files |= {f"plots/{plot.slug}.svg": plot.light.encode() for plot in content.plots}
    pictures: list[Strip | RunFigure] = [*content.strips, *content.figures, *content.sfm_pictures]
    files |= {f"strips/{picture.filename}": picture.webp for picture in pictures}
    files |= {"report.md": report_markdown(content).encode(), "report.html": render_page(content, out).encode()}
    if for_nerfbaselines:
        for run in collection.runs.to_dict("records"):
            table = run["folder"] / "per_image.csv"
            if table.is_file():
                files[f"nerfbaselines/{file_name(run['run'])}.json"] = result_file(run, pd.read_csv(table)).encode()
    return Report(files, (*content.left_out, *content.warnings), terminal_text(content))


def content_of(
    collection: Collection,
    no_pictures: tuple[str, ...] = (),
    levels: tuple[float, ...] = (),
    plots: list[CurvePlot] | None = None,
) -> Content:
    """Tables and pictures of the runs, and `plots`."""
    strips, strip_warnings = make_strips(collection.runs, no_pictures)
    figures, figure_warnings = run_figures(collection.runs, no_pictures)
    sfm_table, sfm_pictures, sfm_warnings = sfm_section(collection.runs, no_pictures)
    warnings = (*collection.warnings, *strip_warnings, *figure_warnings, *sfm_warnings)
    found = [*tables_of(collection, levels), *([] if sfm_table is None else [sfm_table])]
    return Content(collection.runs, collection.left_out, warnings, found, strips, figures, plots or [], sfm_pictures)


def tables_of(collection: Collection, levels: tuple[float, ...] = ()) -> list[Table]:
    """All tables that have rows."""
    built = (spec.build(collection) for spec in (*tables.TABLES, TimeToPsnr(levels), TimeToTarget()))
    return [table for table in built if table is not None]


def plots_of(collection: Collection) -> list[CurvePlot]:
    collection = with_means(collection)
    drawn = {figure: plot(collection, figure) for figure in curve_figures(collection)}
    return [CurvePlot(figure.title, figure.slug, svg, recoloured(svg, DARK)) for figure, svg in drawn.items()]


def render_page(content: Content, out: Path = Path(), page: object = None) -> str:
    """HTML text of page.html, without scripts. The template engine escapes text; images become data URIs. Empty
    sections are left out.

    out: the page's folder, from which links lead to the runs' viewers. page: of a site (site.Page).
    """
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"data_uri": _data_uri, "pieces": pieces, "viewer_link": partial(viewer_link, out=out)}
    return environment.get_template("page.html").render(
        content=content, laid_out=laid_out, sections=content.sections, page=page
    )


def viewer_link(strip: Strip, out: Path) -> str:
    """Relative address of the run's viewer at the strip's view, half of it the truth."""
    assert strip.viewer is not None
    path = os.path.relpath(strip.viewer.resolve(), out.resolve())
    return f"{quote(path)}#view={quote(strip.view)}&compare=wipe"


def pieces(text: str) -> list[str]:
    """`text` split where a line may break: after / _ and =."""
    return re.split(r"(?<=[/_=])", text)


def _data_uri(content: bytes | str, mime: str) -> str:
    content = content.encode() if isinstance(content, str) else content
    return f"data:{mime};base64,{base64.b64encode(content).decode()}"
