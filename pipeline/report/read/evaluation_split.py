"""Selects the runs that were evaluated on the paper's split; only these enter the paper's tables.

The paper evaluates on the test views of a scene, and on `val` for lego.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from pipeline.runs.read.collect import Collection
from pipeline.runs.read.variants import evaluated_on_validation

_ON_VAL = ("dnerf/lego",)  # its test images do not match their time stamps


def other_split(scene: str, settings: Mapping[str, Any]) -> str | None:
    """A sentence on the views a run was evaluated on; None for the paper's split and where the split is unknown."""
    if evaluated_on_validation(settings):
        return "evaluated on training views held out for validation, not on test views."
    if scene in _ON_VAL and settings.get("scene.test_split") == "test":
        return (
            "evaluated on `test`, whose images do not match their time stamps. "
            "The paper evaluates on `val` (scene.test_split=val)."
        )
    return None


def other_split_notes(collection: Collection) -> list[tuple[str, str]]:
    """(scene, note) for each scene and schedule with a run on another split."""
    found = [
        (row["scene"], f"{row['scene']}, {row['train']}: {sentence}")
        for row in collection.runs.to_dict("records")
        if (sentence := other_split(row["scene"], collection.settings[row["run"]]))
    ]
    return list(dict.fromkeys(found))


def on_paper_split(collection: Collection) -> pd.DataFrame:
    """The runs that were evaluated on the paper's split."""
    runs = collection.runs
    return runs.loc[
        [other_split(row["scene"], collection.settings[row["run"]]) is None for row in runs.to_dict("records")]
    ]
