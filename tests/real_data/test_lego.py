"""The released lego scene of the D-NeRF benchmark."""

from __future__ import annotations

from pathlib import Path

import pytest

from datasets.settings import SceneConfig
from datasets.source import open_source

pytestmark = pytest.mark.data


def test_lego(lego: Path) -> None:
    scene = open_source(SceneConfig("dnerf/lego", "dnerf", str(lego), test_split="val")).scene()
    assert (len(scene.train), len(scene.test)) == (50, 11)
    assert scene.train[0].image.shape == (400, 400, 3)
    assert scene.train[0].camera.fx == pytest.approx(1111.11 / 2, rel=1e-4)  # the known focal length
    assert 4.4 < scene.extent < 5.6  # 1.1 × about 4.03; the cameras' centre is above the origin
