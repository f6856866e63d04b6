"""Which training curves stand in one figure: those of runs that differ in one thing, as their settings say.

A scene trained under three schedules, with two optimisers and four ablations is not one figure of many lines but three
of few: schedules, optimisers, ablations. Names do not matter for that, except where a run has no settings.
"""

from __future__ import annotations

import json
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from pipeline.report.read import scenes
from pipeline.runs.read import model_labels as models
from pipeline.runs.read.collect import Collection
from pipeline.runs.read.names import file_name, parts_of, with_parts
from pipeline.runs.read.variants import schedule_settings

# What varies, by the keys that say so. All other keys of schedule and start together make "schedule".
_FACTORS = {
    "batch": ("train.batch",),
    "sampler": ("train.sampler",),
    "resolution": ("train.resolution_steps", "train.resolution_scale"),
    "optimiser": ("train.optimiser",),
}
_NAMES = ("scene.name", "train.name")


@dataclass(frozen=True)
class Line:
    """The seeds of one experiment on a scene, drawn as one line."""

    ablation: str
    train: str
    label: str  # what tells it from the figure's other lines


@dataclass(frozen=True)
class Comparison:
    """The lines of one figure. Titles are unique, and so are slugs."""

    scene: str
    title: str  # `synthetic/wheel: ablation, fast`: what varies, then what all lines share
    lines: tuple[Line, ...]

    @property
    def slug(self) -> str:
        """The title as a file's name."""
        return file_name(re.sub(r"[^\w.-]+", "_", self.title.replace(": ", "__")).strip("_"))


@dataclass(frozen=True)
class _Variant:
    ablation: str
    train: str
    scene: str  # settings of the scene, as text to compare
    schedule: str  # likewise, without those of _FACTORS
    factors: tuple[str, ...]  # value of each of _FACTORS, likewise


_Group = tuple[str, list[_Variant]]  # what varies ("" for a line on its own), and who is compared


def comparisons(collection: Collection) -> list[Comparison]:
    """All figures, scene by scene, schedules first. Each line with a curve of two evaluations at least is in one."""
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
            found.append(Comparison(scene, title, lines))
    return found


def _groups(variants: list[_Variant]) -> list[_Group]:
    groups: list[_Group] = []
    # What selection leaves out of a model is a schedule's doing: schedules are compared by what they were asked for.
    for i, factor in enumerate(_FACTORS):
        alike = _classes(
            variants, lambda v: (models.asked(v.ablation), v.scene, v.schedule, v.factors[:i] + v.factors[i + 1 :])
        )
        groups += [(factor, group) for group in alike if len({v.factors[i] for v in group}) > 1]
    alike = _classes(variants, lambda v: (v.train, v.scene, v.schedule, v.factors))
    groups += [("ablation", group) for group in alike if len({v.ablation for v in group}) > 1]

    times_drawn = {v: sum(v in group for _, group in groups) for v in variants}
    schedules: list[_Group] = []
    for alike in _classes(variants, lambda v: (models.asked(v.ablation), v.scene)):
        # One line a schedule and model: what its variants are variants of. And whatever no other figure has.
        usual = {_representative(same, times_drawn) for same in _classes(alike, lambda v: (v.schedule, v.ablation))}
        shown = [v for v in alike if not times_drawn[v] or (models.asked(v.ablation) == "full" and v in usual)]
        if len({v.train for v in shown}) > 1:
            schedules.append(("schedule", shown))
        elif any(not times_drawn[v] for v in shown):
            schedules.append(("", shown))
    return schedules + groups


def _representative(variants: list[_Variant], times_drawn: dict[_Variant, int]) -> _Variant:
    """What most figures compare with; of several the one with the shortest name."""
    return min(variants, key=lambda v: (-times_drawn[v], len(v.train), v.train))


def _title(scene: str, factor: str, group: list[_Variant]) -> str:
    trains, ablations = {v.train for v in group}, {models.asked(v.ablation) for v in group}
    if all(models.is_left_out(v.ablation) for v in group):
        ablations = {v.ablation for v in group}
    shared = [
        *(trains if len(trains) == 1 else _shared_parts(group)),
        *(ablations - {"full"} if len(ablations) == 1 else ()),
    ]
    return f"{scene}: {', '.join(filter(None, (factor, *shared)))}"


def _shared_parts(group: list[_Variant]) -> list[str]:
    """The settings that stand in brackets after the schedule's name in all of them: they tell no line from another."""
    _, first = parts_of(group[0].train)
    return [part for part in first if all(part in parts_of(v.train)[1] for v in group)]


def _lines(factor: str, group: list[_Variant]) -> tuple[Line, ...]:
    if factor == "ablation":
        of_name = {v.ablation: v for v in group}
        return tuple(Line(name, of_name[name].train, name) for name in scenes.ablations_in_order(of_name))
    told = _shared_parts(group) if len(group) > 1 else []
    ordered = sorted(group, key=lambda v: (len(v.train), v.train, v.ablation))
    return tuple(
        Line(v.ablation, v.train, _without(told, v.train) + (models.LEFT_OUT if models.is_left_out(v.ablation) else ""))
        for v in ordered
    )


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
        # A run without settings is compared with others by its schedule's name.
        schedule=_text(kept, kept.keys() - of_factors - of_scene) if settings else row["train"],
        factors=tuple(_text(kept, keys) for keys in _FACTORS.values()),
    )


def _text(settings: dict, keys: Iterable[str]) -> str:
    return json.dumps({key: settings.get(key) for key in keys}, sort_keys=True, default=str)


def _classes(variants: list[_Variant], key: Callable[[_Variant], object]) -> list[list[_Variant]]:
    """Variants with equal keys together, in order of first appearance."""
    groups: dict[object, list[_Variant]] = defaultdict(list)
    for variant in variants:
        groups[key(variant)].append(variant)
    return list(groups.values())
