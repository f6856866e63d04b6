"""The report as a site: leaderboards, a page for each data set and for each scene, which are reports of their runs.

    index.html  FAMILY.html  FAMILY__SCENE.html  viewers/  films/

The folder can be copied anywhere: pages link to each other only, and load their viewer and films alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pandas as pd

from pipeline.report import scenes
from pipeline.report.build import Report, content_of, plots_of, render_page, tables_of
from pipeline.report.content import Content, terminal_text
from pipeline.report.curve_figures import file_name
from pipeline.report.leaderboard import leaderboards
from pipeline.report.runs import RENDERED, Collection, collect
from pipeline.report.strips import Strip, shown_experiment


@dataclass(frozen=True)
class Link:
    """To another page of the site."""

    title: str
    file: str
    about: str = ""


@dataclass(frozen=True)
class Page:
    """What a page of the site has beside the report of its runs."""

    title: str
    above: Sequence[Link] = ()  # from the first page to the one that it belongs to
    below: Sequence[Link] = ()
    films: Sequence[Link] = ()
    viewer: str = ""  # its file; "": none


HOME = Link("All results", "index.html")


def build_site(roots: Sequence[Path], no_pictures: tuple[str, ...] = (), levels: tuple[float, ...] = ()) -> Report:
    """All files of the site of the runs below `roots`; FileNotFoundError if there are none. Arguments: build_report."""
    collection = collect(*roots)
    runs, warnings = collection.runs, [*collection.left_out, *collection.warnings]
    files: dict[str, bytes] = {}
    of_family = runs.groupby([scenes.family(*row) for row in zip(runs["scene"], runs["capture"])], sort=False)
    below = []
    for name, title in scenes.FAMILIES.items():
        if name not in of_family.groups:
            continue
        found = of_family.get_group(name)
        own = Link(title, f"{name}.html", _counted(found))
        links = []
        for scene in scenes.in_order(found["scene"]):
            rows = found[found["scene"] == scene]
            links.append(Link(scene, f"{file_name(scene.replace('/', '__'))}.html", _counted(rows)))
            pages, said = _scene_page(_part(collection, rows), links[-1], (HOME, own), no_pictures, levels)
            files |= pages
            warnings += said
        files[own.file] = _page(_without_pictures(_part(collection, found), levels), Page(title, (HOME,), links))
        below.append(own)
    index = _without_pictures(collection, levels)
    files["index.html"] = _page(index, Page("4D Gaussian Splatting: results", (), below))
    return Report(files, tuple(dict.fromkeys(warnings)), terminal_text(index))


def _scene_page(
    part: Collection, own: Link, above: Sequence[Link], no_pictures: tuple[str, ...], levels: tuple[float, ...]
) -> tuple[dict[str, bytes], Sequence[str]]:
    """The page of a scene with its viewer and films, and what could not be read."""
    content = content_of(part, no_pictures, levels, plots_of(part))
    files: dict[str, bytes] = {}
    films, viewer = [], ""
    if not scenes.is_excluded(own.title, no_pictures):
        run = _shown_run(part.runs)
        folder, stem = Path(run["folder"]), Path(own.file).stem
        if (folder / "viewer.html").is_file():
            viewer = f"viewers/{stem}.html"
            files[viewer] = (folder / "viewer.html").read_bytes()
        for path in sorted([*folder.glob("renders/*.mp4"), *folder.glob("films/*.mp4")]):
            films.append(Link(path.stem.replace("_", " "), f"films/{stem}__{file_name(path.name)}"))
            files[films[-1].file] = path.read_bytes()
        content = replace(content, strips=[_linked(strip, run, viewer) for strip in content.strips])
    page = Page(own.title, above, films=films, viewer=viewer)
    return files | {own.file: _page(_with_leaderboards(content), page)}, content.warnings


def _shown_run(runs: pd.DataFrame) -> pd.Series:
    """The run whose views are shown (strips.py)."""
    recipe, model = shown_experiment(runs)
    found = runs[(runs["recipe_label"] == recipe) & (runs["model"] == model)]
    return found.sort_values(["images", "seed"], ascending=[False, True]).iloc[0]


def _linked(strip: Strip, run: pd.Series, viewer: str) -> Strip:
    """The strip with a link to the site's viewer, if that plays its run."""
    own = viewer and strip.viewer == Path(run["folder"]) / "viewer.html"
    return replace(strip, viewer=Path(viewer) if own else None)


def _without_pictures(part: Collection, levels: tuple[float, ...]) -> Content:
    return _with_leaderboards(Content(part.runs, part.left_out, part.warnings, tables_of(part, levels), [], [], [], []))


def _with_leaderboards(content: Content) -> Content:
    return replace(content, tables=[*leaderboards(content.runs), *content.tables])


def _part(collection: Collection, runs: pd.DataFrame) -> Collection:
    curves, settings = collection.curves, {run: collection.settings[run] for run in runs["run"]}
    return Collection(runs, curves[curves["run"].isin(runs["run"])], settings)


def _page(content: Content, page: Page) -> bytes:
    return render_page(content, page=page).encode()


def _counted(runs: pd.DataFrame) -> str:
    counts = {"scene": runs["scene"].nunique(), "run": len(runs), "row": int((runs["images"] != RENDERED).sum())}
    parts = [f"{count} {what}{'s' if count != 1 else ''}" for what, count in counts.items()]
    return f"{parts[0]}, {parts[1]}" + (f", {parts[2]} of images given" if counts["row"] else "")
