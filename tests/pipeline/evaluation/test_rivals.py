"""The pictures that a model must beat, on scenes whose rivals are known by construction."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tiny import random_model, tiny_config, tiny_scene

from datasets.scene import Scene, View
from pipeline.evaluation.renderer import Renderer
from pipeline.evaluation.rivals import AgainstRivals, Rivals, mean_picture, nearest_pose
from pipeline.model.model import ModelKind
from pipeline.stages.doubts import EarlyDoubts, doubt
from pipeline.training.reporting import Progress, StepReport
from rasterizer import Camera, Rasterizer


def grey(camera: Camera, time: float, level: int, name: str) -> View:
    return View(camera, time, np.full((camera.height, camera.width, 3), level, np.uint8), name)


def turned(degrees: float, distance: float = 4.0) -> Camera:
    """Looks at the origin from `distance`."""
    angle, pose = np.radians(degrees), np.eye(4)
    pose[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    pose[2, 3] = distance
    return Camera(16, 16, 20.0, 20.0, 8.0, 8.0, pose)


def scene_of(train: list[View], test: list[View]) -> Scene:
    return replace(tiny_scene(), train=tuple(train), test=tuple(test))


def standing(scene: Scene) -> AgainstRivals:
    model = random_model(ModelKind("full", 0, 0))
    return Rivals(scene).compare(Renderer(model, scene, tiny_config(), Rasterizer(threads=1)))


def expected_psnr(difference: float) -> float:
    return -20 * np.log10(difference / 255)


def test_the_nearest_view_is_nearest_in_pose_and_then_in_time() -> None:
    near, far = turned(0), turned(60)
    train = [grey(near, 0, 100, "a"), grey(near, 1, 130, "b"), grey(far, 0, 200, "c"), grey(far, 1, 210, "d")]
    found = standing(scene_of(train, [grey(turned(5), 0.9, 120, "test")]))
    assert found.nearest_view == pytest.approx(expected_psnr(10), abs=1e-4)
    assert found.mean_picture == pytest.approx(expected_psnr(5), abs=1e-4)  # (100 + 130) / 2, of the nearest camera


def test_without_cameras_that_stay_the_mean_is_that_of_all_views() -> None:
    train = [grey(turned(angle), 0, level, f"r_{level}") for angle, level in ((0, 100), (20, 150), (40, 200))]
    found = standing(scene_of(train, [grey(turned(19), 0, 140, "test")]))
    assert (found.nearest_view, found.mean_picture) == pytest.approx((expected_psnr(10),) * 2, abs=1e-4)


def test_distance_counts_beside_the_angle() -> None:
    """Cameras that drive look the same way."""
    others = [turned(0, distance) for distance in (1.0, 3.0, 5.0)]
    assert [nearest_pose(turned(0, distance), others) for distance in (0.5, 2.9, 4.2)] == [0, 1, 2]


def test_views_of_several_sizes_have_a_mean() -> None:
    large, small = turned(0), turned(0).resized(8, 8)
    picture = mean_picture([grey(large, 0, 100, "a"), grey(small, 0, 200, "b")])
    assert picture.shape == (16, 16, 3) and np.allclose(picture, 150 / 255, atol=1e-6)


def test_a_masked_pixel_does_not_count() -> None:
    camera, mask = turned(0), np.ones((16, 16), bool)
    image = np.full((16, 16, 3), 110, np.uint8)
    image[:, :8], mask[:, :8] = 255, False
    found = standing(scene_of([grey(camera, 0, 100, "a")], [View(camera, 0, image, "test", mask=mask)]))
    assert found.nearest_view == pytest.approx(expected_psnr(10), abs=1e-4)


@pytest.mark.parametrize(
    "left, densified, model, said",
    [
        (15_000, True, 20.0, None),
        (15_000, True, 17.0, "it is no better than a picture of the data (17.0 dB; the nearest training view "
         "16.0 dB, the mean of training views 18.0 dB): the poses"),
        (1_348, True, 17.0, "18.0 dB) and 1348 of 20000 initial Gaussians are left: the poses"),
        (15_000, True, 18.9, "no better than a picture"),  # a blur
        (1_348, True, 20.0, None),  # a small model may be a good one
        (20_000, True, 20.0, "the 20000 initial Gaussians are all that there are, though densification was due: the"),
        (20_000, False, 20.0, None),  # too short for densification
    ],
)  # fmt: skip
def test_a_training_that_has_learnt_nothing_is_doubted(left: int, densified: bool, model: float, said: str) -> None:
    found = doubt(20_000, left, densified, AgainstRivals(model, nearest_view=16.0, mean_picture=18.0))
    assert found is None if said is None else found is not None and said in found


def test_doubts_are_said_early_and_once_and_taken_back(tmp_path: Path) -> None:
    """A model of nothing renders black: worse than a picture of grey views, better than one of views unlike the test
    view."""
    said: list[str] = []
    model, cfg = random_model(ModelKind("full", 0, 0)), tiny_config(100)
    model.parameters["opacity_logit"].fill_(-80)
    camera = turned(0)
    bad, good = (scene_of([grey(camera, 0, 100, "a")], [grey(camera, 0, level, "test")]) for level in (100, 0))

    def report(iteration: int, gaussians: int) -> StepReport:
        return StepReport(iteration, 0.0, 0.0, 0.0, gaussians, gaussians)

    watch = EarlyDoubts(100, bad, cfg, Rasterizer(threads=1), lambda row, line: said.append(line))
    watch.step(model, report(9, 100))
    assert not said  # a tenth of the schedule
    watch.step(model, report(10, 100))
    watch.evaluated(model, Progress(20, 0.0), {})
    watch.step(model, report(30, 9))  # collapsed
    assert len(said) == 1 and said[0].startswith("iteration 10: no better yet than a picture of the data")

    watch = EarlyDoubts(100, good, cfg, Rasterizer(threads=1), lambda row, line: said.append(line))
    watch.step(model, report(10, 100))
    assert len(said) == 1, "nothing to say of a training that learns"
