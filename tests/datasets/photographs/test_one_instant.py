"""Numbers in names count cameras or frames: which, the poses tell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from datasets.files.errors import SceneError
from datasets.photographs.file_names import with_times
from datasets.photographs.one_instant import are_filmed
from datasets.photographs.photograph import PosedFile
from datasets.photographs.selection import held_out_names
from datasets.settings import SceneConfig
from pipeline.evaluation.pictures.camera_path import look_at
from rasterizer.camera import Camera


def ring(count: int, degrees: float, pattern: str = "{:04d}") -> list[PosedFile]:
    """On a ring around the origin, `degrees` apart."""
    found = []
    for i in range(count):
        angle = np.radians(degrees * i)
        place = np.array([4 * np.cos(angle), 4 * np.sin(angle), 1.0])
        camera = Camera(40, 30, 50.0, 50.0, 20.0, 15.0, look_at(place, np.zeros(3), np.array([0.0, 0.0, 1.0])))
        name = pattern.format(i)
        found.append(PosedFile(name, Path(f"{name}.png"), camera))
    return found


@pytest.mark.parametrize(
    ("photographs", "filmed"),
    [
        (ring(31, 360 / 31), False),  # a dome
        (ring(31, 360 / 31, "frame_{:04d}"), False),
        (ring(300, 1.2), True),
        (ring(20, 2.0), True),  # a short film: steps are large compared with its path
        (ring(20, 2.0, "cam{:02d}"), False),
        (ring(20, 2.0, "view_{:02d}_undistorted"), False),
    ],
)
def test_a_film_is_told_from_a_rig(photographs: list[PosedFile], filmed: bool) -> None:
    assert are_filmed(photographs) == filmed
    lines: list[str] = []
    times = {photograph.time for photograph in with_times(photographs, lines.append)}
    assert len(times) == (len(photographs) if filmed else 1)
    assert ("as of one instant" in lines[0]) != filmed


@pytest.mark.parametrize(
    ("settings", "held_out", "how"),
    [
        ({}, {"cam05"}, "every 8th frame"),
        ({"test_every": 0}, {"cam01"}, "camera 1 (cam01)"),  # 0, the default, is the first
        ({"test_cameras": [3, 12]}, {"cam03", "cam12"}, "camera 3 (cam03), 12 (cam12)"),
    ],
)
def test_each_photograph_of_one_instant_is_a_camera(settings: dict, held_out: set[str], how: str) -> None:
    photographs = with_times(ring(13, 20.0, "cam{:02d}")[1:], lambda line: None)
    cfg = SceneConfig(name="rig", reader="colmap", **settings)
    assert held_out_names(Path("rig"), photographs, cfg) == (held_out, how)


@pytest.mark.parametrize(
    ("pattern", "settings", "message"),
    [
        ("cam{:02d}", {"test_cameras": [40]}, r"test_cameras: expected some of the cameras 0 .*found \[40\]"),
        ("{:04d}", {"test_cameras": [2]}, r"test_cameras: expected \[0\] for photographs by one camera, found \[2\]"),
        ("{:04d}", {"test_every": 0}, r"test_every: expected at least 2 for photographs by one camera, found 0"),
    ],
)
def test_cameras_that_are_not_there_are_refused(pattern: str, settings: dict, message: str) -> None:
    photographs = with_times(ring(30, 2.0, pattern), lambda line: None)
    with pytest.raises(SceneError, match=message):
        held_out_names(Path("rig"), photographs, SceneConfig(name="rig", reader="colmap", **settings))
