"""Optical flow measured in the images: a textured plane that moves, what appears, pairs of frames, and the cache."""

from __future__ import annotations

import errno
from io import FileIO
from pathlib import Path

import numpy as np
import pytest
from tiny import tiny_scene
from tiny_film import (
    PLANE,
    PLANE_DEPTH,
    RATE,
    clip_past_a_plane,
    moving_plane,
    plane_image,
    texture,
    tiny_film,
    unsynchronised_film,
)

from pipeline.data import optical_flow
from pipeline.data.optical_flow import FlowTargets, measure_flow, measured_size, neighbours, resized_flow


@pytest.mark.parametrize("shift", [(0, 0), (3, -1), (-6, 4)])
def test_the_flow_of_a_moving_plane_is_its_motion(shift: tuple[int, int]) -> None:
    flow = measure_flow(plane_image(0, 0), plane_image(*shift)) * PLANE[1]
    trusted = np.isfinite(flow[..., 0])
    assert trusted.mean() > 0.8, "all but the border that leaves the image"
    # Of a pixel: the search's own accuracy on 8-bit images.
    assert np.median(np.abs(flow[trusted] - shift)) < 0.05


def test_what_appears_is_not_trusted() -> None:
    first, second = plane_image(0, 0), plane_image(2, 1)
    hidden = np.s_[30:60, 40:80]
    second[hidden] = texture(seed=1)[hidden][..., None]
    trusted = np.isfinite(resized_flow(measure_flow(first, second), PLANE[1], PLANE[0])[0].numpy())
    inside = np.s_[34:56, 44:76]
    assert trusted[inside].mean() < 0.2 < 0.8 < trusted.mean()


def test_flow_is_averaged_over_what_is_trusted() -> None:
    flow = np.zeros((4, 4, 2), np.float16)
    flow[:2, :2] = [[[1, 2], [3, 4]], [[5, 6], [np.nan, np.nan]]]
    flow[2:, 2:] = np.nan
    half = resized_flow(flow, 2, 2).numpy()
    np.testing.assert_allclose(half[:, 0, 0], [3, 4], rtol=1e-6)  # of three trusted pixels
    np.testing.assert_array_equal(half[:, 1, 0], [0, 0])
    assert np.isnan(half[:, 1, 1]).all()
    np.testing.assert_array_equal(resized_flow(flow, 4, 4).numpy(), flow.astype(np.float32).transpose(2, 0, 1))


def test_pairs_are_consecutive_frames_of_one_camera() -> None:
    views = tiny_film(frames=4).train  # four frames each of three cameras
    gap = 1.5 / RATE
    assert neighbours(views, gap) == {i: i + 1 if i % 4 < 3 else i - 1 for i in range(12)}
    assert neighbours(views[::2], gap) == {}, "frames in between are missing"
    photographs, gap = tiny_scene(views=12).train, 1.5 / 11
    assert neighbours(photographs, gap) == {}, "cameras jump from one time to the next"
    assert neighbours(photographs, gap, one_camera=True) == {i: i + 1 if i < 11 else 10 for i in range(12)}
    assert neighbours(photographs[::2], gap, one_camera=True) == {}, "frames in between are missing"


def test_flow_of_a_clip_comes_with_the_camera_that_sees_it(tmp_path: Path) -> None:
    """A plane that stands still, passed by the camera: its flow is that of a point of it, projected by both cameras."""
    clip = clip_past_a_plane()
    view, other = clip.train[1], clip.train[2]
    target = FlowTargets(clip, tmp_path).at(1, view.camera.resized(64, 48))
    np.testing.assert_allclose(target.camera.world_to_cam, other.camera.world_to_cam)
    assert (target.camera.width, target.camera.height) == (64, 48) and target.camera.fx == 0.5 * other.camera.fx
    point = np.array([0.1, -0.2, PLANE_DEPTH]) - view.camera.world_to_cam[:3, 3]  # the rotation is the identity
    seen = [(c.fx * (point + c.world_to_cam[:3, 3]) / PLANE_DEPTH)[0] for c in (view.camera, other.camera)]
    measured = np.nanmedian(target.flow.numpy(), axis=(1, 2)) * PLANE[1]
    np.testing.assert_allclose(measured, [seen[1] - seen[0], 0], atol=0.1)  # a pixel is measured to 0.05
    assert FlowTargets(moving_plane(), tmp_path).at(1, view.camera).camera is None, "it stands still"


def test_views_of_cameras_that_are_not_synchronised_have_flow(tmp_path: Path) -> None:
    film = unsynchronised_film(frames=4)
    targets = FlowTargets(film, tmp_path)
    found = [targets.at(index, view.camera) for index, view in enumerate(film.train)]
    steps = [None if flow is None else round(flow.step * 30, 9) for flow in found]
    assert steps == [1, 1, 1, -1] * 4


def test_flow_of_a_film_has_the_sign_of_its_step(tmp_path: Path) -> None:
    """The last frame's flow leads back to the one before."""
    targets = FlowTargets(moving_plane(), tmp_path)
    first, last = (targets.at(index, moving_plane().train[0].camera) for index in (0, 3))
    assert first.step == pytest.approx(1 / RATE) and last.step == pytest.approx(-1 / RATE)
    moved = [np.nanmedian(found.flow.numpy(), axis=(1, 2)) * PLANE[1] for found in (first, last)]
    np.testing.assert_allclose(moved, [[2, 1], [-2, -1]], atol=0.1)


def test_flow_is_the_same_from_memory_and_file_and_measured_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    film, measured = moving_plane(), []
    (tmp_path / "no_folder").touch()
    places = {"memory": (tmp_path, 2**30), "file": (tmp_path / "cache", 0), "nowhere": (tmp_path / "no_folder", 0)}
    camera = film.train[0].camera.resized(64, 48)
    monkeypatch.setattr(optical_flow, "measure_flow", lambda *pair: measured.append(pair) or measure_flow(*pair))
    expected = resized_flow(measure_flow(film.train[1].image, film.train[2].image), 64, 48)
    for name, (folder, memory) in places.items():
        targets = FlowTargets(film, folder, memory)
        measured.clear()
        found = [targets.at(index, camera).flow.numpy() for index in (1, 0, 1, 0)]
        assert len(measured) == (4 if name == "nowhere" else 2), name
        np.testing.assert_array_equal(found[:2], found[2:])
        # Half precision keeps eleven bits, of flow up to a tenth of the width.
        np.testing.assert_allclose(found[0], expected, atol=0.1 * 2**-11)


@pytest.mark.parametrize("full", ["fails", "writes a part"])
def test_a_full_disk_leaves_what_is_kept_readable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, full: str) -> None:
    film, files = moving_plane(), []

    class FullDisk(FileIO):
        """Takes one flow."""

        def write(self, data: bytes) -> int:
            if self.tell() == 0:
                return super().write(data)
            if full == "fails":
                raise OSError(errno.ENOSPC, "No space left on device")
            return super().write(data[:10])

    def on_full_disk(dir: Path, buffering: int) -> FullDisk:
        assert buffering == 0
        files.append(FullDisk(dir / "flow", "w+"))
        return files[-1]

    monkeypatch.setattr(optical_flow, "TemporaryFile", on_full_disk)
    targets, others = FlowTargets(film, tmp_path, 0), FlowTargets(film, tmp_path)
    camera = film.train[0].camera
    for index in (1, 0, 1, 2, 1, 0):
        np.testing.assert_array_equal(targets.at(index, camera).flow, others.at(index, camera).flow)
    assert len(files) == 1


def test_flow_is_measured_at_a_size_of_its_own() -> None:
    assert measured_size(160, 120) == (320, 240)
    assert measured_size(338, 254) == (338, 254)
    assert measured_size(1352, 1014) == (338, 254)  # 253.5, to even


def test_flow_of_a_strip_lower_than_a_patch_is_not_trusted() -> None:
    """OpenCV refuses images below 8 px a side; an image of 20 × 3 is searched at 320 × 48, one of 320 × 3 as it is."""
    for width, trusted in ((20, True), (320, False)):
        strip = np.random.default_rng(0).integers(0, 256, (3, width, 3), dtype=np.uint8)
        flow = measure_flow(strip, strip)
        assert flow.shape[:2] == measured_size(width, 3)[::-1]
        assert np.isfinite(flow).any() == trusted
