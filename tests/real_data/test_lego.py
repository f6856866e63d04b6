"""The D-NeRF benchmark's lego scene, read as it was released."""

from __future__ import annotations

from pathlib import Path

import pytest

from datasets.dnerf import read_dnerf

pytestmark = pytest.mark.data


def test_it_is_the_benchmarks_scene(lego: Path) -> None:
    scene = read_dnerf(lego, name="dnerf/lego", test_split="val")
    assert (len(scene.train), len(scene.test)) == (50, 11)
    assert scene.train[0].image.shape == (400, 400, 3)
    assert scene.train[0].camera.fx == pytest.approx(1111.11 / 2, rel=1e-4)  # the benchmark's known focal length
    assert 4.4 < scene.extent < 5.6  # 1.1 × about 4.03, their centre lying above the origin
