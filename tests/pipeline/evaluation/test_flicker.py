"""Flicker against its definition, written out naively, and against cases with known flicker."""

from __future__ import annotations

import numpy as np
import pytest
from tiny import tiny_scene

from datasets.scene import View
from pipeline.evaluation.image_metrics import FlickerMeter
from pipeline.evaluation.metrics import METRICS, mean

CAMERA = tiny_scene().test[0].camera
RATE = 30.0
# Sums of a few hundred float32 terms in different orders.
FLOAT32 = 1e-6


def frame(number: int, camera: str = "cam00", rate: float = RATE) -> View:
    return View(CAMERA, number / rate, tiny_scene().test[0].image, f"test/{camera}_{number:04d}", filmed_by=camera)


def noise(frames: int, seed: int = 0) -> np.ndarray:
    """(F, 5, 7, 3) float32 in [0, 1]."""
    return np.random.default_rng(seed).random((frames, 5, 7, 3), dtype=np.float32)


def mean_flicker(changes: list[float | None]) -> float | None:
    return mean([{"flicker": change} for change in changes], "flicker", METRICS["flicker"].partial)


def metered(images: np.ndarray, truths: np.ndarray, views: list[View]) -> list[float | None]:
    meter = FlickerMeter(RATE)
    return [meter.next(*each) for each in zip(views, images, truths)]


def test_against_loops() -> None:
    images, truths = noise(4), noise(4, 1)
    changes = []
    for t in range(3):
        total = 0.0
        for y in range(5):
            for x in range(7):
                for channel in range(3):
                    now, after = (float(images[i, y, x, channel]) - float(truths[i, y, x, channel]) for i in (t, t + 1))
                    total += abs(after - now)
        changes.append(total / (5 * 7 * 3))
    found = metered(images, truths, [frame(i) for i in range(4)])
    assert found[0] is None and found[1:] == pytest.approx(changes, abs=FLOAT32)
    assert mean_flicker(found) == pytest.approx(sum(changes) / 3, abs=FLOAT32)


def test_a_constant_error_does_not_flicker() -> None:
    truths = 0.5 * noise(4)  # the motion is in the ground truth
    views = [frame(i) for i in range(4)]
    assert metered(truths, truths, views) == [None, 0.0, 0.0, 0.0]
    assert metered(truths + np.float32(0.25), truths, views) == pytest.approx([None, 0.0, 0.0, 0.0], abs=FLOAT32)


def test_an_alternating_error_flickers_by_twice_its_size() -> None:
    truths = np.full((5, 4, 6, 3), 0.5, np.float32)
    signs = np.float32([1, -1, 1, -1, 1]).reshape(-1, 1, 1, 1)
    found = metered(truths + np.float32(0.125) * signs, truths, [frame(i) for i in range(5)])
    assert found == [None, 0.25, 0.25, 0.25, 0.25] and mean_flicker(found) == 0.25


def test_flicker_depends_on_the_order_of_the_errors() -> None:
    """Two videos with the same errors in different orders have equal PSNR but different flicker."""
    errors, truths = np.float32([0, 0, 0.5, 0.5]).reshape(-1, 1, 1, 1), np.zeros((4, 2, 2, 3), np.float32)
    views = [frame(i) for i in range(4)]
    assert mean_flicker(metered(truths + errors, truths, views)) == pytest.approx(0.5 / 3)
    assert mean_flicker(metered(truths + errors[[0, 2, 1, 3]], truths, views)) == pytest.approx(0.5)


@pytest.mark.parametrize(
    "views, compared",
    [
        ([frame(0), frame(1), frame(3), frame(4)], [False, True, False, True]),  # frame 2 is missing
        ([frame(0), frame(1), frame(2, "cam01"), frame(3, "cam01")], [False, True, False, True]),  # another camera
        ([frame(3), frame(2), frame(1)], [False, False, False]),  # backwards
        ([frame(0, rate=15), frame(1, rate=15)], [False, False]),  # every second frame
        ([frame(0), frame(0)], [False, False]),
    ],
)
def test_only_the_next_frame_of_the_same_camera_is_compared(views: list[View], compared: list[bool]) -> None:
    images = noise(len(views))
    assert [change is not None for change in metered(images, images, views)] == compared


def test_photographs_have_no_flicker() -> None:
    meter = FlickerMeter(None)
    assert [meter.next(frame(i), image, image) for i, image in enumerate(noise(3))] == [None] * 3
    assert mean_flicker([None, None]) is None


def test_rounded_times_are_consecutive_frames() -> None:
    """Milliseconds at 30 frames per second: 33, 67, 100 …"""
    views = [View(CAMERA, round(i / 30, 3), frame(0).image, f"test/cam00_{i}") for i in range(300)]
    images = noise(300)
    assert None not in metered(images, images, views)[1:]


def test_the_images_are_not_modified() -> None:
    images, truths = noise(3), noise(3, 1)
    before = images.copy(), truths.copy()
    metered(images, truths, [frame(i) for i in range(3)])
    assert (images == before[0]).all() and (truths == before[1]).all()
