"""Frames per second: which views are timed, and the two clocks."""

from __future__ import annotations

import numpy as np
import pytest
from tiny import evaluation_config, tiny_config, tiny_scene

from pipeline.evaluation import renderer as renderer_module
from pipeline.evaluation.renderer import Renderer, frames_per_second
from pipeline.model.initialise import initialise
from pipeline.model.model import Model
from rasterizer import Rasterizer


@pytest.fixture(scope="module")
def model() -> Model:
    return initialise(tiny_scene(), tiny_config(), np.random.default_rng(0))


def test_speed_views_are_rendered_in_each_pass(model: Model, monkeypatch) -> None:
    rendered = []
    monkeypatch.setattr(renderer_module, "SPEED_VIEWS", 2)
    monkeypatch.setattr(Renderer, "tensor", lambda self, camera, time: rendered.append(time))
    monkeypatch.setattr(Rasterizer, "stage_ms", {"blend": 1.0})
    _, raster = frames_per_second(model, tiny_scene(), evaluation_config(speed_repeats=2), 1)
    assert rendered == [0.0, tiny_scene().test[-1].time] * 2
    assert raster == pytest.approx(1000.0)


def test_blending_alone_is_faster_than_rendering(model: Model) -> None:
    render, raster = frames_per_second(model, tiny_scene(), evaluation_config(), 1)
    assert raster > render > 0
