"""Gives runs with different settings different names: `train=fast train.iterations=600` -> `fast (iterations=600)`.

Two sources: the overrides that environment.json records, and the settings in config.yaml. A command with
`scene.frames=30` is named `fast (scene.frames=30)`. Settings may also differ without an override (an edited preset, an
older run that recorded only its shell command). So all runs of a scene with one `train` name are compared key by key,
and a run that differs from the usual settings gets the differing keys in its name.

The `ablation` name becomes the label of the trained model (model_labels.py). Its settings are compared with those in
conf/ablation.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import PurePath
from typing import Any

import pandas as pd

from pipeline.config.renamed_keys import ADDED, renamed_key
from pipeline.runs.read import model_labels as models
from pipeline.runs.read.collect import Collection
from pipeline.runs.read.run_names import parts_of, with_parts
from pipeline.runs.run_identity import FREE_KEYS

# Keys that do not affect the trained model, and the seed.
_IGNORED = (*FREE_KEYS, "seed", "train.checkpoint_every", "hydra")
_NAMED = ("train.", "scene.", "init.")  # overrides that become part of the name
VALIDATION = "scene.validation_every"
_MAX_KEYS = 3  # differing keys in a name


def name_variants(collection: Collection) -> Collection:
    """The same runs with names that are equal only where the settings are; repeated runs move to `left_out`."""
    runs, settings = collection.runs, collection.settings
    runs = runs.assign(
        train=[
            _with_overrides(name, overrides, settings[run])
            for name, overrides, run in zip(runs["train"], runs["overrides"], runs["run"])
        ]
    )
    runs = runs.assign(
        train=_distinct_names(runs, "train", {run: schedule_settings(settings[run]) for run in runs["run"]}),
        ablation=_model_names(runs, settings),
    )

    key = ["scene", "ablation", "train", "seed"]
    repeated = runs.duplicated(key)
    first = runs[~repeated].set_index(key)["run"]
    left_out = tuple(
        f"{row['run']}: left out: same scene, ablation, settings and seed as {first[tuple(row[key])]}"
        for _, row in runs[repeated].iterrows()
    )
    runs = runs[~repeated].reset_index(drop=True)

    curves = collection.curves[collection.curves["run"].isin(runs["run"])]
    by_run = runs.set_index("run")
    curves = curves.assign(**{c: curves["run"].map(by_run[c]) for c in ("train", "ablation")})
    return replace(collection, runs=runs, curves=curves.reset_index(drop=True), left_out=collection.left_out + left_out)


def _with_overrides(name: str, overrides: Sequence[str], settings: dict[str, Any]) -> str:
    """`name` and the overrides of schedule, scene and initialisation, under the keys' current names.

    Evaluation on validation views is always named, also where no override set it.
    """
    unnamed = (*_IGNORED, "scene.path", "scene.name")  # the scene's name is a column of its own
    given = dict(
        override.partition("=")[::2] for override in map(_current_key, overrides)
    )  # of a repeated key the last
    if evaluated_on_validation(settings):
        given.setdefault(VALIDATION, str(settings[VALIDATION]))
    changed = [
        f"{key}={_one_spelling(value)}".removeprefix("train.")
        for key, value in sorted(given.items())  # one name, whatever order the command gave them in
        if f"{key}=".startswith(_NAMED) and key not in unnamed
    ]
    return with_parts(name, changed)


def _one_spelling(value: str) -> str:
    """0.1 for .1, 0.10 and 1e-1; what is no number as it is."""
    try:
        return f"{float(value):.15g}"
    except ValueError:
        return value


def _current_key(override: str) -> str:
    """`key=value` under the key's current name, without Hydra's prefix +."""
    key, equals, value = override.lstrip("+").partition("=")
    return renamed_key(key) + equals + value


def evaluated_on_validation(settings: Mapping[str, Any]) -> bool:
    """Whether the run was evaluated on training views held out for validation, not on test views."""
    return settings.get(VALIDATION) not in (None, 0)


def _distinct_names(
    runs: pd.DataFrame,
    column: str,
    settings: dict[str, dict[str, Any]],
    preset: Callable[[str], Mapping[str, Any] | None] = lambda name: None,
) -> pd.Series:
    """`column` with the keys in which a run differs from the expected settings of its name.

    Expected are the settings that `preset` gives for the name; where it gives None, the scene's usual settings.
    """
    names: dict[str, str] = {}
    differences: dict[str, dict[str, Any]] = {}
    for (_, name), group in runs.groupby(["scene", column], sort=False)["run"]:
        given, usual = preset(name), _usual([settings[run] for run in group if settings[run]])
        for run in group:
            own = settings[run]
            expected = usual if given is None else {key: given.get(key) for key in own}
            names[run] = with_parts(name, _difference(own, expected) if own else [])
            differences[run] = {key: own.get(key) for key in _differing(own, expected)} if own else {}
        _tell_apart(names, differences, list(group))
    return runs["run"].map(names)


def _tell_apart(names: dict[str, str], differences: dict[str, dict[str, Any]], group: list[str]) -> None:
    """Of `group`, runs whose settings differ in keys that their names do not show get a hash of these; in place.

    A hash, not a number: the same settings have the same name on all scenes.
    """
    for name in {names[run] for run in group}:
        same = [run for run in group if names[run] == name]
        texts = [json.dumps(differences[run], sort_keys=True, default=str) for run in same]
        if len(set(texts)) > 1:
            base, parts = parts_of(name)
            for run, text in zip(same, texts):
                names[run] = with_parts(base, [*parts, f"variant {hashlib.sha256(text.encode()).hexdigest()[:4]}"])


def _model_names(runs: pd.DataFrame, settings: dict[str, dict[str, Any]]) -> pd.Series:
    """Labels of the trained models; a name that is not in conf/ablation is compared with the usual settings."""
    trained = {
        row["run"]: models.trained_model(row["ablation"], settings[row["run"]], row) for row in runs.to_dict("records")
    }
    labels = [
        models.STATIC if found_static else f"{name}{models.LEFT_OUT}" if trained[run].left_out else name
        for run, name, found_static in zip(runs["run"], runs["ablation"], runs["found_static"])
    ]
    settings = {run: model.settings for run, model in trained.items()}
    return _distinct_names(
        runs.assign(ablation=labels), "ablation", settings, lambda name: models.settings_of(models.requested(name))
    )


def _usual(settings: list[dict[str, Any]]) -> dict[str, Any]:
    """The settings with the smallest total number of differing keys to all others.

    In a study that changes one key per variant these are the unchanged settings.
    """
    texts = [json.dumps(one, sort_keys=True, default=str) for one in settings]
    distinct, counts = dict(zip(texts, settings)), Counter(texts)

    def distance(text: str) -> int:
        return sum(n * len(_differing(distinct[text], distinct[other])) for other, n in counts.items())

    return distinct[min(distinct, key=distance)] if distinct else {}


def schedule_settings(settings: dict[str, Any]) -> dict[str, Any]:
    """The settings that a run's result depends on, without its ablation and its seed."""
    kept = {
        key: value
        for key, value in settings.items()
        if not key.startswith("ablation.") and not any(key == i or key.startswith(i + ".") for i in _IGNORED)
    }
    # A scene may lie in different places, so only the folder's name is compared.
    if kept.get("scene.path"):
        kept["scene.path"] = PurePath(str(kept["scene.path"])).name
    return kept


def _difference(settings: dict[str, Any], usual: dict[str, Any]) -> list[str]:
    """`iterations=600` for each of the first _MAX_KEYS differing keys, then `2 more`."""
    keys = _differing(settings, usual)
    shown = [f"{key.removeprefix('train.')}={settings.get(key)}" for key in keys[:_MAX_KEYS]]
    return shown + ([f"{len(keys) - _MAX_KEYS} more"] if len(keys) > _MAX_KEYS else [])


def _differing(one: dict[str, Any], other: dict[str, Any]) -> list[str]:
    """The keys of which the values differ. A run of before a key was added has the value that changes nothing."""

    def value(settings: dict[str, Any], key: str) -> Any:
        return settings.get(key, ADDED.get(key))

    return sorted(key for key in one.keys() | other.keys() if value(one, key) != value(other, key))
