"""Images and films of an evaluation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from tiny_film import tiny_film

from pipeline.evaluation.metrics import MeasuredView
from pipeline.evaluation.pictures import films
from pipeline.evaluation.pictures.view_pictures import DIFFERENCE_GAIN, picture_saver


def test_render_truth_and_difference_are_written(tmp_path: Path) -> None:
    image, truth = np.full((4, 6, 3), 0.5, np.float32), np.full((4, 6, 3), 0.4, np.float32)
    picture_saver(tmp_path / "renders", tiny_film())("test/r_0", MeasuredView(image, truth))
    read = {path.name: np.asarray(Image.open(path)) for path in (tmp_path / "renders").iterdir()}
    assert sorted(read) == ["test_r_0_difference.png", "test_r_0_render.png", "test_r_0_truth.png"]
    assert read["test_r_0_render.png"].shape == (4, 6, 3) and (read["test_r_0_render.png"] == 128).all()
    assert (read["test_r_0_truth.png"] == 102).all()
    assert (read["test_r_0_difference.png"] == round(0.1 * DIFFERENCE_GAIN * 255)).all()


def test_films_of_cameras_that_move_show_one_camera_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    sent: dict[str, list[float]] = {}

    @contextmanager
    def video(path: Path, width: int, height: int, frame_rate: float) -> Iterator[Callable[[np.ndarray], None]]:
        sent[path.name] = []
        yield lambda image: sent[path.name].append(round(float(image[0, 0, 0]), 3))

    monkeypatch.setattr(films, "video", video)
    monkeypatch.setattr(films, "write_bullet_time", lambda path, renderer: None)
    scene = replace(tiny_film(), frame_rate=None, playback_rate=10.0)
    renderer = SimpleNamespace(
        scene=scene,
        cfg=SimpleNamespace(train=SimpleNamespace(resolution_scale=1.0)),
        image=lambda camera, time: np.full((camera.height, camera.width, 3), time, np.float32),
    )
    films.write_clip_films(Path(), renderer, 10.0)
    times = sorted({view.time for view in scene.train})
    assert sent["path_render_and_truth.mp4"] == times * 5  # five cameras
    assert sent["still_camera.mp4"] == times  # of one
    still = tiny_film(held_out=("cam00",))  # four cameras at places of their own
    unnamed = {s: tuple(replace(view, filmed_by="") for view in getattr(still, s)) for s in ("train", "test")}
    still = replace(still, **unnamed)
    films.write_clip_films(Path(), SimpleNamespace(**{**vars(renderer), "scene": still}), 10.0)
    assert sent["path_render_and_truth.mp4"] == times * 4, "each that stands still by itself, as beside DyCheck's clips"
