"""A table of the paper with our rows below or between: the printed numbers from results/paper/*.csv, as printed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from pipeline.evaluation.metrics import METRICS
from pipeline.evaluation.protocol import protocols
from pipeline.presentation.table import NO_RUN, NOT_REPORTED, Cell, Column, Row, Table, printed
from pipeline.report import scenes
from pipeline.report.run_table import PROTOCOL_NOTE, Shown, gpu_notes, missing_notes, protocol_notes
from pipeline.report.runs import BEST, FINAL, GIVEN, Collection

PAPER_DIR = Path(__file__).resolve().parents[2] / "results" / "paper"
THIS_PAPER = "4DGS (this paper)"
_PROTOCOL = {FINAL: "final", BEST: "best on test"}


@dataclass(frozen=True)
class Averaged:
    """A column: a metric averaged over scenes. `key` is that of the CSV."""

    key: str
    metric: str
    scenes: tuple[str, ...]
    header: str = ""  # the metric's, unless given
    complete: bool = False  # only with a run of every scene; otherwise the number of scenes is stated
    mean_of: tuple[str, ...] = ()  # where the paper's number is not at hand: the mean of these columns


@dataclass(frozen=True)
class PaperTable:
    """A table of the paper as data. Left out without a run of ours; so are scenes without one."""

    slug: str  # and the name of the CSV
    title: str
    scenes: tuple[str, ...]
    columns: tuple[Averaged, ...]
    by_model: bool = False  # the rows are ablations, ours follow each; else ours are of `full` and follow all
    notes: tuple[str, ...] = ()
    section: str = "paper"

    def build(self, collection: Collection) -> Table | None:
        runs = scenes.on_paper_split(collection)
        runs = runs[runs["scene"].isin(self.scenes)]
        rows: list[Row] = []
        marks = ""
        for line in read(self.slug):
            marks += line["note"]
            rows.append(self._printed(line))
            if self.by_model:
                rows += self._ours(runs[runs["model"] == line["model"]])
        if not self.by_model:
            rows += self._ours(runs[(runs["model"] == scenes.FULL) | (runs["images"] == GIVEN)])
        if not any(row.kind == "ours" for row in rows):
            return None
        heads = [Column("method", "Method", False), Column("protocol", "Protocol", False, fold=True)]
        if self.by_model:
            heads.insert(0, Column("model", "Ablation", False))
        elif any(not self._is_partial(column) for column in self.columns):
            heads.append(Column("scenes", "Scenes", False))
        keys = [column.metric for column in self.columns]
        notes = protocol_notes(row.cells["protocol"].text for row in rows)
        notes += [METRICS[key].note for key in keys if METRICS[key].note]
        notes += gpu_notes(runs, keys)
        notes += [PROTOCOL_NOTE, *missing_notes(runs, keys), *_decided(runs), *self.notes]
        notes += [f"Not in this table: {note}" for note in scenes.other_split_notes(collection, self.scenes)]
        return Table(
            self.slug,
            self.title,
            (*heads, *map(self._column, self.columns)),
            tuple(rows),
            notes=(*footnotes(marks), *(("", note) for note in dict.fromkeys(notes))),
            section=self.section,
        )

    def _is_partial(self, column: Averaged) -> bool:
        """Whether the column is of some scenes, or of all or none; then it is hidden without a number of ours."""
        return column.complete or len(column.scenes) < len(self.scenes)

    def _column(self, column: Averaged) -> Column:
        header = column.header or METRICS[column.metric].header
        return Column(column.key, header, ours_only=self._is_partial(column))

    def _printed(self, line: dict[str, str]) -> Row:
        cells = {"method": Cell(line.get("method", THIS_PAPER)), "model": Cell(line.get("model", ""))}
        cells["scenes"], cells["protocol"] = Cell(line.get("scenes") or "–"), Cell(line["protocol"])
        for column in self.columns:
            parts = [line[part] for part in column.mean_of if line.get(part)]
            cells[column.key] = printed(line.get(column.key, ""))
            if not line.get(column.key) and parts and len(parts) == len(column.mean_of):
                mean = sum(map(float, parts)) / len(parts)
                decimals = max(len(part.partition(".")[2]) for part in parts)
                cells[column.key] = Cell(f"{mean + 1e-9:.{decimals}f}", mean)  # 0.9605 rounds up in binary too
        if protocols()[line["protocol"]].psnr == "channels" and "psnr_channels" in cells:
            cells["psnr_channels"], cells["psnr"] = cells["psnr"], NOT_REPORTED
        return Row(cells, "paper" if cells["method"].text == THIS_PAPER else "other", line["note"])

    def _ours(self, runs: pd.DataFrame) -> list[Row]:
        rows = []
        for (images, method, protocol_id), of_method in runs.groupby(["images", "method", "protocol"], sort=True):
            covered, wanted = of_method["scene"].nunique(), len(self.scenes)
            given = images == GIVEN
            for protocol, name in ((FINAL, ""),) if given else _PROTOCOL.items():
                cells = {
                    "method": Cell(f"{method}, images given" if given else f"Ours, {method}, {name}"),
                    "protocol": Cell(protocol_id),
                    "model": Cell(of_method["model"].iloc[0]),
                    "scenes": Cell(str(wanted) if covered == wanted else f"mean of {covered} of {wanted}"),
                }
                for column in self.columns:
                    found = of_method[of_method["scene"].isin(column.scenes)]
                    missing = found.empty or (column.complete and found["scene"].nunique() < len(column.scenes))
                    cells[column.key] = NO_RUN if missing else Shown(column.metric, protocol).cell(found)
                rows.append(Row(cells))
        return rows


def _decided(runs: pd.DataFrame) -> list[str]:
    """What validation decided about the models of a mean."""
    found = runs[runs["decided"].astype(bool)].groupby(["method", "validation"], sort=True)["scene"]
    return [
        f"Ours, {method}: validation decided {decided} on {', '.join(map(scenes.short, scenes.in_order(names)))}."
        for (method, decided), names in found
    ]


def read(name: str) -> list[dict[str, str]]:
    """Rows of `name`.csv as strings (32.00 stays 32.00); FileNotFoundError if there is no such file."""
    path = PAPER_DIR / f"{name}.csv"
    if not path.is_file():
        raise FileNotFoundError(f"{path}: expected the paper's numbers, found nothing")
    return pd.read_csv(path, dtype=str, keep_default_na=False).to_dict("records")


def footnotes(marks: str) -> tuple[tuple[str, str], ...]:
    """(mark, text) for each of `marks`, in the file's order."""
    return tuple((row["mark"], row["text"]) for row in read("footnotes") if row["mark"] in marks)
