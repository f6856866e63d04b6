"""Scenes of the paper's tables, families and order of scenes and models, and what each ablation is made for."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

import pandas as pd

from pipeline.report.runs import Collection

# In the column order of the paper's per-scene table.
PLENOPTIC = tuple(
    f"plenoptic/{name}"
    for name in ("coffee_martini", "cook_spinach", "cut_roasted_beef", "flame_salmon", "flame_steak", "sear_steak")
)
# The eight scenes of Table 2.
DNERF = tuple(
    f"dnerf/{name}"
    for name in ("bouncingballs", "hellwarrior", "hook", "jumpingjacks", "lego", "mutant", "standup", "trex")
)
TABLE3 = ("plenoptic/flame_salmon", "plenoptic/cut_roasted_beef")  # of the ablations
ABLATIONS = ("no_4drot", "no_4dsh", "no_time_split", "full")  # in the row order of Table 3
FULL = "full"

# Family -> title of its table. The first three are known by name; others are what their data are, Scene.capture.
FAMILIES = {
    "synthetic": "Synthetic scenes",
    "dnerf": "D-NeRF",
    "plenoptic": "Plenoptic Video",
    "static": "Static scenes",
    "monocular": "Photographs of one moving camera",
    "multi_view": "Multi-view videos",
    "clip": "Clips of one camera",
    "drive": "Driving logs",
}


@dataclass(frozen=True)
class MadeFor:
    """An ablation, the synthetic scene that needs the ablated part, and the reason."""

    ablation: str
    scene: str
    reason: str


MADE_FOR = (
    MadeFor("no_4drot", "synthetic/wheel", "fast motion; without 4D rotation a Gaussian has no velocity"),
    MadeFor(
        "no_4dsh",
        "synthetic/lamp",
        "colours change with time and view; without Fourier orders they are constant in time",
    ),
    MadeFor(
        "no_time_split",
        "synthetic/burst",
        "objects appear and vanish; a split in space alone leaves the temporal means unchanged",
    ),
    MadeFor(
        "no_error_guided",
        "synthetic/burst",
        "Gaussians are added where and when the error is, which is not in the paper",
    ),
)


def family(scene: str, capture: str) -> str:
    """One of FAMILIES: the paper's scenes, synthetic ones, others by what their data are."""
    if scene in DNERF or scene in PLENOPTIC or scene.startswith("synthetic/"):
        return scene.split("/")[0]
    return capture


def in_order(names: Iterable[str]) -> list[str]:
    """Unique scenes or their labels in the order of the report: means of families, synthetic, D-NeRF, Plenoptic Video,
    others."""
    first = (*FAMILIES.values(), *(made.scene for made in MADE_FOR), "synthetic/still", *DNERF, *PLENOPTIC)
    place = {name: number for number, name in enumerate(first)}
    return sorted(set(names), key=lambda name: (place.get(re.split(r" \(|, mean", name)[0], len(first)), name))


def models_in_order(names: Iterable[str]) -> list[str]:
    """Unique models in the order of the report: `full`, the paper's ablations, others."""
    place = {name: number for number, name in enumerate((FULL, *ABLATIONS[:3]))}
    return sorted(set(names), key=lambda name: (place.get(name, len(place)), name))


def short(scene: str) -> str:
    """`dnerf/lego` -> `lego`."""
    return scene.rsplit("/", 1)[-1]


def is_excluded(scene: str, no_pictures: tuple[str, ...]) -> bool:
    """Whether the scene or its family is one of those whose images may not be published."""
    return scene in no_pictures or scene.split("/")[0] in no_pictures


def other_split(run: dict, collection: Collection) -> str | None:
    """Why a run was not evaluated on the paper's views: a scene's test views, and `val` for lego; None where it was."""
    settings = collection.settings[run["run"]]
    if settings.get("scene.validation_every") not in (None, 0):
        return "evaluated on training views held out for validation, not on test views."
    if run["scene"] == "dnerf/lego" and settings.get("scene.test_split") == "test":
        return (
            "evaluated on `test`, whose images do not match their time stamps. "
            "The paper evaluates on `val` (scene.test_split=val)."
        )
    return None


def on_paper_split(collection: Collection) -> pd.DataFrame:
    """The runs that were evaluated on the paper's views; only these enter its tables."""
    return collection.runs[[other_split(row, collection) is None for row in collection.runs.to_dict("records")]]


def other_split_notes(collection: Collection, among: Iterable[str]) -> list[str]:
    """A sentence on each of the scenes `among` and each schedule with a run on another split."""
    rows = collection.runs[collection.runs["scene"].isin(list(among))].to_dict("records")
    notes = (f"{row['scene']}, {row['method']}: {found}" for row in rows if (found := other_split(row, collection)))
    return list(dict.fromkeys(notes))
