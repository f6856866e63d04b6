"""Groups learning curves into figures: the runs of one figure differ in a single factor of their settings.

A scene with three schedules, two optimisers and four ablations gets three figures of few curves, one per factor.
Runs are grouped by their settings; a run without settings is grouped by its schedule's name.
"""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from pipeline.report.read import scenes
from pipeline.runs.read import model_labels as models
from pipeline.runs.read.collect import Collection
from pipeline.runs.read.run_names import file_name, parts_of, with_parts
from pipeline.runs.read.variants import schedule_settings

# Factor -> its keys. All other keys of schedule and initialisation together are the factor "schedule".
_FACTORS = {
    "batch": ("train.batch",),
    "resolution": ("train.resolution_steps", "train.resolution_scale"),
    "optimiser": ("train.optimiser",),
}
_NAMES = ("scene.name", "train.name")


@dataclass(frozen=True)
class Line:
    """The seeds of one experiment on a scene, drawn as one line."""

    ablation: str
    train: str
    label: str  # distinguishes it from the other lines of the figure


@dataclass(frozen=True)
class CurveFigure:
    """The lines of one figure. Titles and slugs are unique."""

    scene: str
    title: str  # `synthetic/wheel: ablation, fast`: the factor, then the settings that all lines share
    lines: tuple[Line, ...]

    @property
    def slug(self) -> str:
        """The title as a file name."""
        return file_name(self.title.replace(": ", "__")).strip("_")


@dataclass(frozen=True)
class _Variant:
    ablation: str
    train: str
    scene: str  # settings of the scene, as JSON
    schedule: str  # other settings, without those of _FACTORS
    factors: tuple[str, ...]  # settings of each of _FACTORS


_Group = tuple[str, list[_Variant]]  # the factor ("" for a single line) and the variants compared


def curve_figures(collection: Collection) -> list[CurveFigure]:
    """All figures, by scene, schedules first. Every curve with at least two evaluations is in a figure."""
    curves = collection.curves
    curves = curves[curves.groupby("run")["iteration"].transform("size") > 1]
    found = []
    for scene in scenes.in_order(curves["scene"]):
        of_scene = curves[curves["scene"] == scene].drop_duplicates(["ablation", "train"])
        variants = [_variant(row, collection.settings[row["run"]]) for row in of_scene.to_dict("records")]
        groups = _groups(variants)
        titles = [_title(scene, factor, group) for factor, group in groups]
        for (factor, group), title in zip(groups, titles):
            lines = _lines(factor, group)
            if Counter(titles)[title] > 1:
                title += f", {lines[0].train} and others"
            found.append(CurveFigure(scene, title, lines))
    return found


def _groups(variants: list[_Variant]) -> list[_Group]:
    groups: list[_Group] = []
    # Schedules are compared for one requested model: selection by validation is a part of the schedule.
    for i, factor in enumerate(_FACTORS):

        def others(v: _Variant, i: int = i) -> object:
            return models.requested(v.ablation), v.scene, v.schedule, v.factors[:i] + v.factors[i + 1 :]

        groups += [(factor, group) for group in _classes(variants, others) if len({v.factors[i] for v in group}) > 1]
    same = _classes(variants, lambda v: (v.train, v.scene, v.schedule, v.factors))
    groups += [("ablation", group) for group in same if len({v.ablation for v in group}) > 1]

    times_drawn = {v: sum(v in group for _, group in groups) for v in variants}
    schedules: list[_Group] = []
    for same_model in _classes(variants, lambda v: (models.requested(v.ablation), v.scene)):
        # One line per schedule and model, its most common variant; and every variant without a figure.
        usual = {
            _representative(same, times_drawn) for same in _classes(same_model, lambda v: (v.schedule, v.ablation))
        }
        shown = [v for v in same_model if not times_drawn[v] or (models.requested(v.ablation) == "full" and v in usual)]
        if len({v.train for v in shown}) > 1:
            schedules.append(("schedule", shown))
        elif any(not times_drawn[v] for v in shown):
            schedules.append(("", shown))
    return schedules + groups


def _representative(variants: list[_Variant], times_drawn: dict[_Variant, int]) -> _Variant:
    """The variant in most figures; of several the one with the shortest name."""
    return min(variants, key=lambda v: (-times_drawn[v], len(v.train), v.train))


def _title(scene: str, factor: str, group: list[_Variant]) -> str:
    trains, ablations = {v.train for v in group}, {models.requested(v.ablation) for v in group}
    if all(models.is_left_out(v.ablation) for v in group):
        ablations = {v.ablation for v in group}
    shared = [
        *(trains if len(trains) == 1 else _shared_parts(group)),
        *(ablations - {"full"} if len(ablations) == 1 else ()),
    ]
    return f"{scene}: {', '.join(filter(None, (factor, *shared)))}"


def _shared_parts(group: list[_Variant]) -> list[str]:
    """The settings in brackets that all schedule names of the group have."""
    _, first = parts_of(group[0].train)
    return [part for part in first if all(part in parts_of(v.train)[1] for v in group)]


def _lines(factor: str, group: list[_Variant]) -> tuple[Line, ...]:
    if factor == "ablation":
        of_name = {v.ablation: v for v in group}
        return tuple(Line(name, of_name[name].train, name) for name in scenes.ablations_in_order(of_name))
    shared = _shared_parts(group) if len(group) > 1 else []
    ordered = sorted(group, key=lambda v: (len(v.train), v.train, v.ablation))
    suffixes = [models.LEFT_OUT if models.is_left_out(v.ablation) else "" for v in ordered]
    return tuple(Line(v.ablation, v.train, _without(shared, v.train) + end) for v, end in zip(ordered, suffixes))


def _without(parts: list[str], train: str) -> str:
    name, found = parts_of(train)
    return with_parts(name, [part for part in found if part not in parts])


def _variant(row: dict, settings: dict) -> _Variant:
    kept = {key: value for key, value in schedule_settings(settings).items() if key not in _NAMES}
    of_factors = {key for keys in _FACTORS.values() for key in keys}
    of_scene = {key for key in kept if key.startswith("scene.")}
    return _Variant(
        ablation=row["ablation"],
        train=row["train"],
        scene=_text(kept, of_scene),
        # A run without settings is grouped by its schedule's name.
        schedule=_text(kept, kept.keys() - of_factors - of_scene) if settings else row["train"],
        factors=tuple(_text(kept, keys) for keys in _FACTORS.values()),
    )


def _text(settings: dict, keys: Iterable[str]) -> str:
    return json.dumps({key: settings.get(key) for key in keys}, sort_keys=True, default=str)


def _classes(variants: list[_Variant], key: Callable[[_Variant], object]) -> list[list[_Variant]]:
    """Groups of variants with equal keys, in order of first appearance."""
    groups: dict[object, list[_Variant]] = defaultdict(list)
    for variant in variants:
        groups[key(variant)].append(variant)
    return list(groups.values())
