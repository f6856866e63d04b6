"""The scene of a clip's frames, or of several clips', once structure from motion has found the cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from datasets.canonical import canonical_space
from datasets.composition import Color
from datasets.scene import Scene, View, camera_extent, capture_of, validate_scene

PLAYBACK_RATES = (5.0, 60.0)  # frames a second of rendered videos


def scene_of_views(
    views: Mapping[str, Sequence[View]],
    *,
    name: str,
    source: Path,
    duration: float,
    unit: float | None,
    rate: float,
    test_split: str,
    background: Color,
) -> Scene:
    """The scene of the views of both splits, "train" and "test", whose first time is 0; duration in seconds.

    unit: world units per normalised unit; None: the canonical unit of the training cameras. rate: frames a second of
    rendered videos.
    """
    train = [view.camera for view in views["train"]]
    space = canonical_space(train, unit)
    return validate_scene(
        Scene(
            name=name,
            train=tuple(views["train"]),
            test=tuple(views["test"]),
            duration=duration,
            time_start=0.0,
            background=background,
            extent=camera_extent(train),
            init_box=space.inverse.box((-1.2, 1.2)),
            source=source,
            capture=capture_of(views["train"], views["test"], filmed=True),
            unit=unit or space.unit,
            playback_rate=rate,
            test_split=test_split,
        )
    )


def playback_rate(times: Sequence[float]) -> float:
    """Frames a second at which frames of these times (seconds, ascending) last as long as they did."""
    return float(np.clip((len(times) - 1) / max(times[-1] - times[0], 1e-3), *PLAYBACK_RATES))
