"""On which views a run was measured, where those are not the ones that the paper's numbers are of.

The paper tests on a scene's test views, lego on `val`. Numbers of others stand in no table of the paper's.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from pipeline.runs.read.collect import Collection
from pipeline.runs.read.variants import measured_on_validation

_ON_VAL = ("dnerf/lego",)  # the images of its test split do not match their times


def other_views(scene: str, settings: Mapping[str, Any]) -> str | None:
    """What a run of `scene` was measured on, in a sentence; None for the paper's views, and where nothing says it."""
    if measured_on_validation(settings):
        return "measured on training views held out for validation, not on test views."
    if scene in _ON_VAL and settings.get("scene.test_split") == "test":
        return (
            "tested on `test`, whose images do not match their times; the paper tests on `val` (scene.test_split=val)."
        )
    return None


def measured_elsewhere(collection: Collection) -> list[tuple[str, str]]:
    """(scene, note) for each scene and schedule of which a run was measured on other views."""
    found = [
        (row["scene"], f"{row['scene']}, {row['train']}: {said}")
        for row in collection.runs.to_dict("records")
        if (said := other_views(row["scene"], collection.settings[row["run"]]))
    ]
    return list(dict.fromkeys(found))


def on_papers_views(collection: Collection) -> pd.DataFrame:
    """The runs that may stand in the paper's tables."""
    runs = collection.runs
    return runs.loc[
        [other_views(row["scene"], collection.settings[row["run"]]) is None for row in runs.to_dict("records")]
    ]
