"""One self-contained HTML page: page.html filled in, every image inline, no script, nothing fetched."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from .strips import DIFFERENCE_GAIN, Strip
from .structure import Structure
from .study import STUDY
from .summary import Summary
from .table import Table


@dataclass(frozen=True)
class CurvePlot:
    """One figure in both themes, as SVG text."""

    title: str
    slug: str  # names its file
    light: str
    dark: str


COMPARISONS = ("equal_time", "time_to_psnr", "batches")  # slugs of tables that set schedules side by side


def render_page(
    summary: Summary,
    paper_tables: Sequence[Table],
    our_tables: Sequence[Table],
    plots: Sequence[CurvePlot],
    strips: Sequence[Strip],
    structure: Structure | None = None,
) -> str:
    """HTML text. Text is escaped by the template engine; images become data URIs. Without `structure` no section."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["svg_uri"] = lambda svg: _data_uri("image/svg+xml", svg.encode())
    environment.filters["webp_uri"] = lambda webp: _data_uri("image/webp", webp)
    own = {table.slug: table for table in our_tables}
    return environment.get_template("page.html").render(
        summary=summary,
        paper_tables=paper_tables,
        verdicts=own["ablation_verdicts"],
        scene_tables=[t for t in our_tables if t.slug.startswith("scenes_")],
        comparisons=[own[slug] for slug in COMPARISONS if slug in own]
        + [table for slug, table in own.items() if slug.startswith(STUDY)],
        structure=structure,
        raw_tables=[own["all_runs"], own["provenance"]],
        plots=plots,
        strips=_by_group(strips),
        difference_gain=DIFFERENCE_GAIN,
    )


def _by_group(strips: Sequence[Strip]) -> Mapping[tuple[str, str], list[Strip]]:
    """(scene, schedule) -> its strips, order kept."""
    groups: dict[tuple[str, str], list[Strip]] = {}
    for strip in strips:
        groups.setdefault((strip.scene, strip.train), []).append(strip)
    return groups


def _data_uri(mime: str, content: bytes) -> str:
    return f"data:{mime};base64,{base64.b64encode(content).decode()}"
