"""The one table of runs: rows are groups of runs that share some columns, columns are metrics averaged over seeds.

`against` finds the baseline of a row among the others. A `RunTable` is such a table as data; tables.py lists them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from pipeline.evaluation.metrics import METRICS, Metric
from pipeline.evaluation.protocol import in_words, one_protocol
from pipeline.presentation.statistics import FORMULA, Estimate, estimate, verdicts
from pipeline.presentation.table import NO_RUN, NOTHING, Cell, Column, Row, Table, measured, number, signed
from pipeline.report import scenes
from pipeline.report.runs import BEST, FINAL, GIVEN, Collection

HEADERS = {  # of the columns that rows are grouped by
    "run": "Run",
    "scene_label": "Scene",
    "protocol": "Protocol",
    "recipe_label": "Recipe",
    "model": "Model",
    "images": "Images",
    "trained": "Trained model",
    "validation": "Decided by validation",
    "machine": "Machine",
    "date": "Date",
    "git_commit": "Commit",
    "command": "Command",
}
FOLDED = ("protocol", "recipe_label", "model", "images", "trained", "validation", "machine", "date", "git_commit")
PROTOCOL_NOTE = (
    "final: the last iteration. best on test: the best of all test evaluations. The authors' release reports the "
    "latter, which selects on the test set."
)


TIMED = ("fps_render", "fps_raster", "train_seconds")  # numbers of the device, not of the method
GPU_MARK = "†"


@dataclass(frozen=True)
class Shown:
    key: str
    protocol: str = FINAL  # no meaning for costs

    @property
    def metric(self) -> Metric:
        return METRICS[self.key]

    @property
    def column(self) -> str:
        """Of Collection.runs, and of the table."""
        return self.metric.column(self.protocol)

    @property
    def header(self) -> str:
        return self.metric.header + (" best on test" if self.protocol == BEST else "")

    @property
    def title(self) -> str:
        return self.metric.title + (" best on test" if self.protocol == BEST else "")

    def numbers(self, runs: pd.DataFrame) -> pd.Series:
        return self.metric.scale * runs[self.column]

    def estimate(self, runs: pd.DataFrame) -> Estimate | None:
        """Over the seeds; over several scenes the mean of their means, and the std of the seeds that all have.

        MixedProtocols where the runs follow several protocols."""
        one_protocol(runs["protocol"], f"{self.title} of {len(runs)} runs")
        if runs["scene_label"].nunique() <= 1:
            return estimate(self.numbers(runs))
        if self.numbers(runs).isna().any():
            return None
        values = runs.assign(value=self.numbers(runs)).pivot_table(index="scene_label", columns="seed", values="value")
        common = values.dropna(axis=1).mean(axis=0)
        std = float(common.std(ddof=1)) if len(common) > 1 else np.nan
        return Estimate(float(values.mean(axis=1).mean()), std, max(len(common), 1))

    def cell(self, runs: pd.DataFrame) -> Cell:
        found = measured(self.estimate(runs), self.metric.decimals)
        by_gpu = self.key in TIMED and found.value is not None and (runs["gpu"] != "").any()
        return replace(found, text=f"{found.text} {GPU_MARK}") if by_gpu else found

    def difference(self, runs: pd.DataFrame, baseline: pd.DataFrame) -> Estimate | None:
        """Of one scene, over the seeds that both sides have; None where there is none or a number is missing.

        MixedProtocols where the sides follow different ones."""
        one_protocol([*runs["protocol"], *baseline["protocol"]], f"difference in {self.title}")
        changed, base = (self.numbers(side).groupby(side["seed"]).mean() for side in (runs, baseline))
        common = changed.index.intersection(base.index)
        return estimate(changed[common] - base[common])


def shown(*groups: str, protocol: str = FINAL) -> tuple[Shown, ...]:
    return tuple(Shown(key, protocol) for key, metric in METRICS.items() if metric.group in groups)


Key = tuple[str, ...]  # of a row: the values of its columns
Groups = Mapping[Key, pd.DataFrame]  # the rows of a table
Baseline = Callable[[Key, Groups], "Key | None"]  # of a row: the row that it is compared with; None: it is one itself


def full_model(key: Key, groups: Groups) -> Key | None:
    """The same scene, protocol, recipe and changes with model=full. Rows: (…, model)."""
    return None if key[-1] in (scenes.FULL, GIVEN) else (*key[:-1], scenes.FULL)


def fewest_changes(key: Key, groups: Groups) -> Key | None:
    """The same scene, protocol and model with the fewest of the run's own changes; of its recipe, or else of the only
    other one.

    An experiment names its recipes: `no_jitter (train.marginal_jitter=0)` is compared with `short`.
    Rows: (scene, protocol, model, …).
    """
    own = groups[key].iloc[0]
    found = [
        (run["recipe"] != own["recipe"], len(run["changes"]), other)
        for other, group in groups.items()
        if other[:3] == key[:3] and (run := group.iloc[0])["changes"].items() < own["changes"].items()
    ]
    first = sorted(found)[:2]
    several = len(first) == 2 and first[0][0] and first[0][:2] == first[1][:2]
    return first[0][-1] if first and not several else None


@dataclass(frozen=True)
class RunTable:
    slug: str
    title: str
    rows: tuple[str, ...]  # columns of Collection.runs; runs that are equal in them are averaged
    columns: Callable[[], Sequence[Shown]] = tuple  # called for each report: METRICS may have grown
    where: Callable[[pd.DataFrame], pd.Series] | None = None  # which runs
    against: Baseline | None = None
    baseline_name: str = ""  # in the header of differences
    differences: Callable[[], Sequence[Shown]] = tuple  # a column of differences from the baseline for each of these
    verdicts: int = 99  # the first so many differences have a verdict
    only_compared: bool = False  # leave out what is neither compared with a baseline nor a baseline of others
    across_scenes: bool = False  # a row for the mean over scenes, where there are several
    section: str = "comparisons"
    notes: tuple[str, ...] = ()

    def build(self, collection: Collection) -> Table | None:
        """None without rows."""
        runs = collection.runs
        runs = runs if self.where is None else runs[self.where(runs).astype(bool)]
        if runs.empty:
            return None
        columns, differences = (
            [one for one in wanted() if one.metric.group == "quality" or one.numbers(runs).notna().any()]
            for wanted in (self.columns, self.differences)
        )
        groups = dict(_groups(runs, self.rows))
        bases = {key: self.against(key, groups) if self.against else None for key in groups}
        if self.only_compared:
            with_base = {key: bases[key] for key in groups if bases[key] in groups}
            groups = {key: group for key, group in groups.items() if key in {*with_base, *with_base.values()}}
            if not groups:
                return None
        found: dict[tuple, list[Estimate | None]] = {}  # key -> its differences
        for key, group in groups.items():
            if differences and (base := groups.get(bases[key] or ())) is not None:
                found[key] = [one.difference(group, base) for one in differences]
        by_scene = _over_scenes(self, found) if self.across_scenes else {}
        compared = found | {rest: means for rest, (_, means) in by_scene.items()}
        words = dict(zip(compared, _judged(differences[: self.verdicts], list(compared.values()))))
        rows: list[Row] = []
        for key, group in groups.items():
            cells = {name: Cell(str(value)) for name, value in zip(self.rows, key)}
            cells |= {"seeds": number(len(group), 0)} | {one.column: one.cell(group) for one in columns}
            missing = "" if bases[key] is None else f"no run of {self.baseline_name}"
            cells |= _difference_cells(differences, found.get(key), words.get(key, ()), missing)
            rows.append(Row(cells))
        for rest, (keys, means) in by_scene.items():
            names = iter(rest)
            heads = {
                name: Cell(f"mean of {len(keys)}" if name == "scene_label" else str(next(names))) for name in self.rows
            }
            every = pd.concat([groups[key] for key in keys])
            cells = heads | {"seeds": NO_RUN} | {one.column: one.cell(every) for one in columns}
            rows.append(Row(cells | _difference_cells(differences, means, words[rest], "")))
        return Table(
            self.slug,
            self.title,
            _columns(self, columns, differences),
            tuple(rows),
            notes=_notes(runs, [*columns, *differences], bool(found), self.notes),
            over_seeds="run" not in self.rows,
            section=self.section,
        )


def _groups(runs: pd.DataFrame, names: Sequence[str]) -> Iterator[tuple[tuple, pd.DataFrame]]:
    """(values of `names`, runs) in the order of the report; the unchanged runs come first."""
    order: dict[str, Callable[[Any], list[str]]] = {"scene_label": scenes.in_order, "model": scenes.models_in_order}
    places = {name: {value: i for i, value in enumerate(order[name](runs[name]))} for name in names if name in order}

    def place(item: tuple[tuple, pd.DataFrame]) -> list:
        return [places[name][value] if name in places else (len(value), value) for name, value in zip(names, item[0])]

    yield from sorted(runs.groupby(list(names), sort=False), key=place)


def _columns(spec: RunTable, columns: Sequence[Shown], differences: Sequence[Shown]) -> tuple[Column, ...]:
    heads = [Column(name, HEADERS.get(name, name), False, fold=name in FOLDED) for name in spec.rows]
    if columns and "run" not in spec.rows:
        heads.append(Column("seeds", "Seeds", fold=True))
    compared = []
    for i, one in enumerate(differences):
        header = f"this − {spec.baseline_name}, {one.title}"
        compared.append(Column(f"{one.column}.difference", header, group="difference"))
        if i < spec.verdicts:
            compared.append(Column(f"{one.column}.verdict", "Verdict", False, group="difference"))
    values = [Column(one.column, one.header, group=one.metric.group) for one in columns]
    return (*heads, *values, *compared)


def _judged(differences: Sequence[Shown], rows: Sequence[Sequence[Estimate | None]]) -> list[list[str]]:
    """The verdicts of each row of differences; "" where one was not measured. Holm's correction is over all."""
    known = [(one, value) for values in rows for one, value in zip(differences, values) if value is not None]
    words = iter(verdicts([value for _, value in known], [one.metric.better for one, _ in known]))
    return [["" if value is None else next(words) for _, value in zip(differences, values)] for values in rows]


def _difference_cells(
    differences: Sequence[Shown], values: Sequence[Estimate | None] | None, words: Sequence[str], missing: str
) -> dict[str, Cell]:
    """values: None without a baseline; missing: why there is none, "" for a baseline itself."""
    cells: dict[str, Cell] = {}
    for i, one in enumerate(differences):
        name, verdict = f"{one.column}.difference", f"{one.column}.verdict"
        value = None if values is None else values[i]
        if value is None:
            why = missing if values is None else "not measured"
            cells |= {name: NOTHING, verdict: Cell(why) if why else NOTHING}
        else:
            cells |= {name: signed(value, one.metric.decimals), verdict: Cell(words[i] if i < len(words) else "")}
    return cells


def _without_scene(spec: RunTable, key: tuple) -> tuple:
    return tuple(value for name, value in zip(spec.rows, key) if name != "scene_label")


def _over_scenes(
    spec: RunTable, found: Mapping[tuple, list[Estimate | None]]
) -> dict[tuple, tuple[list[tuple], list[Estimate | None]]]:
    """For each change that several scenes have: their keys, and the mean differences over them."""
    of_change: dict[tuple, list[tuple]] = {}
    for key in found:
        of_change.setdefault(_without_scene(spec, key), []).append(key)
    return {
        rest: (keys, [_over([found[key][i] for key in keys]) for i in range(len(found[keys[0]]))])
        for rest, keys in of_change.items()
        if len(keys) > 1
    }


def _over(of_scenes: Sequence[Estimate | None]) -> Estimate | None:
    """The mean of those that were measured."""
    return estimate(one.mean for one in of_scenes if one is not None)


def _notes(
    runs: pd.DataFrame, columns: Sequence[Shown], with_verdict: bool, more: Sequence[str]
) -> tuple[tuple[str, str], ...]:
    """Protocol, verdict, definitions of the metrics, why numbers are missing, held-out views, and `more`."""
    notes = [*protocol_notes(runs["protocol"]), *([FORMULA] if with_verdict else [])] if columns else []
    notes += [PROTOCOL_NOTE] if any(one.protocol == BEST for one in columns) else []
    notes += [one.metric.note for one in columns if one.metric.note]
    notes += gpu_notes(runs, [one.key for one in columns])
    notes += missing_notes(runs, [one.key for one in columns])
    splits = runs[["scene", "test_split"]].drop_duplicates().to_dict("records") if columns else []
    notes += [f"{row['scene']}: held out {row['test_split']}." for row in splits if row["test_split"]]
    return tuple(("", note) for note in dict.fromkeys((*notes, *more)))


def protocol_notes(ids: Iterable[str]) -> list[str]:
    """What the protocols of a table's rows are; of several, that nothing across them is averaged."""
    found = sorted(set(ids))
    several = [f"Rows of {len(found)} protocols: none are averaged, compared or ranked across them."]
    return [*(several if len(found) > 1 else []), *map(in_words, found)]


def gpu_notes(runs: pd.DataFrame, keys: Sequence[str]) -> list[str]:
    """What the mark of times and frames a second says, where some are a GPU's."""
    devices = sorted(set(runs["gpu"]) - {""})
    if not devices or not set(keys) & set(TIMED):
        return []
    return [f"{GPU_MARK}: on a GPU ({'; '.join(devices)}), whose results are not bit-identical; others: on a CPU."]


def missing_notes(runs: pd.DataFrame, keys: Sequence[str]) -> list[str]:
    """Why LPIPS or MS-SSIM is missing, as the runs record it, where `keys` has such a metric."""
    wanted = {"lpips_note": "LPIPS", "ms_ssim_note": "MS-SSIM"}
    return [
        note if note.startswith(name) else f"{name}: {note}"
        for column, name in wanted.items()
        if any(key.startswith(column.split("_note")[0]) for key in keys)
        for note in sorted(set(runs[column]))
        if note
    ]
