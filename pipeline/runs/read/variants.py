"""Tells runs apart that carry one name but not one set of settings.

`train=fast train.iterations=600` is still called `fast` in its run folder. Here it is `fast (iterations=600)`, and with
`scene.frames=30` it is `fast (scene.frames=30)`: the report takes what the command changed into the name, so that no
schedule passes for another and no part of a scene for the whole. Settings can differ
without the command saying so (an edited file), so inside a scene all runs with one `train` name (and one `ablation`
name) are compared key by key too; those that differ from the usual ones get the differing keys in their name.

The name of an ablation becomes that of the model that was trained (models.py): its settings are compared with those
that conf/ablation gives the name.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import PurePath
from typing import Any

import pandas as pd

from pipeline.config.renamed_keys import renamed_key
from pipeline.runs.read import model_labels as models
from pipeline.runs.read.collect import Collection
from pipeline.runs.read.names import with_parts

# Keys that may differ between runs of one experiment: the seed, where things lie, how many threads (images
# and gradients do not depend on it), how often a checkpoint is written and what is written besides the
# metrics.
_FREE = (
    "seed",
    "out",
    "threads",
    "resume",
    "estimate",
    "scene.cache",
    "train.checkpoint_every",
    "train.checkpoint_keep_moments",
    "evaluate",
    "hydra",
)
_NAMED = ("train.", "scene.", "init.", "background_model=")  # what a command changes, of these, goes into the name
VALIDATION = "scene.validation_every"
_SHOWN = 3  # differing keys spelled out in a name


def name_variants(collection: Collection) -> Collection:
    """The same runs under names equal only where the settings are; repeated runs are left out, and named."""
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
    renamed = runs.set_index("run")
    curves = curves.assign(**{c: curves["run"].map(renamed[c]) for c in ("train", "ablation")})
    return replace(collection, runs=runs, curves=curves.reset_index(drop=True), left_out=collection.left_out + left_out)


def _with_overrides(name: str, overrides: Sequence[str], settings: dict[str, Any]) -> str:
    """`name`, plus the settings of schedule, scene and start that the run's command line changed.

    And that it was not measured on test views but on training views held out for validation, whoever changed that.
    """
    free = (*_FREE, "scene.path", "scene.name")  # of the folder, schedule_settings compares the name
    changed = [
        w.removeprefix("train.") for w in map(_today, overrides) if w.startswith(_NAMED) and w.split("=")[0] not in free
    ]
    if measured_on_validation(settings) and not any(part.startswith(f"{VALIDATION}=") for part in changed):
        changed.append(f"{VALIDATION}={settings[VALIDATION]}")
    return with_parts(name, changed)


def _today(override: str) -> str:
    """`key=value` under the key's name of today; without the + that adds a key."""
    key, equals, value = override.lstrip("+").partition("=")
    return renamed_key(key) + equals + value


def measured_on_validation(settings: dict[str, Any]) -> bool:
    """Do training views stand in for the run's test views, to choose settings by?"""
    return settings.get(VALIDATION) not in (None, 0)


def _distinct_names(
    runs: pd.DataFrame,
    column: str,
    settings: dict[str, dict[str, Any]],
    known: Callable[[str], Mapping[str, Any] | None] = lambda name: None,
) -> pd.Series:
    """`column`, plus the differing keys where a run's settings are not the usual ones of its name: those that `known`
    gives it, else those of the scene's other runs."""
    names: dict[str, str] = {}
    for (_, name), group in runs.groupby(["scene", column], sort=False)["run"]:
        given, usual = known(name), _usual([settings[run] for run in group if settings[run]])
        for run in group:
            own = settings[run]
            expected = usual if given is None else {key: given.get(key) for key in own}
            names[run] = with_parts(name, _difference(own, expected) if own else [])
    return runs["run"].map(names)


def _model_names(runs: pd.DataFrame, settings: dict[str, dict[str, Any]]) -> pd.Series:
    """The names of the trained models; an ablation that conf/ablation does not have is compared with the usual settings
    of its name."""
    found = {row["run"]: models.trained(row["ablation"], settings[row["run"]], row) for row in runs.to_dict("records")}
    selected = [
        f"{name}{models.LEFT_OUT}" if found[run].left_out else name for run, name in zip(runs["run"], runs["ablation"])
    ]
    settings = {run: kind.settings for run, kind in found.items()}
    return _distinct_names(
        runs.assign(ablation=selected), "ablation", settings, lambda name: models.settings_of(models.asked(name))
    )


def _usual(settings: list[dict[str, Any]]) -> dict[str, Any]:
    """Those that the others differ from in the fewest keys, all together: of a study that changes one key in each
    variant, what they are variants of."""
    texts = [json.dumps(one, sort_keys=True, default=str) for one in settings]
    distinct, times = dict(zip(texts, settings)), Counter(texts)

    def distance(text: str) -> int:
        return sum(n * len(_differing(distinct[text], distinct[other])) for other, n in times.items())

    return distinct[min(distinct, key=distance)] if distinct else {}


def schedule_settings(settings: dict[str, Any]) -> dict[str, Any]:
    """What a run's result depends on besides its ablation and its seed."""
    kept = {
        key: value
        for key, value in settings.items()
        if not key.startswith("ablation.") and not any(key == f or key.startswith(f + ".") for f in _FREE)
    }
    # Another machine keeps the same scene elsewhere; but a folder of another name is another scene.
    if kept.get("scene.path"):
        kept["scene.path"] = PurePath(str(kept["scene.path"])).name
    return kept


def _difference(settings: dict[str, Any], usual: dict[str, Any]) -> list[str]:
    """`iterations=600` for each key whose value is not the usual one; the first three, then how many more."""
    keys = _differing(settings, usual)
    shown = [f"{key.removeprefix('train.')}={settings.get(key)}" for key in keys[:_SHOWN]]
    return shown + ([f"{len(keys) - _SHOWN} more"] if len(keys) > _SHOWN else [])


def _differing(one: dict[str, Any], other: dict[str, Any]) -> list[str]:
    return sorted(key for key in one.keys() | other.keys() if one.get(key) != other.get(key))
