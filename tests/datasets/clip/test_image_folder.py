"""A folder of images as a clip: order, times, orientation, transparency, size; what is refused."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from clips import SIZE, frames, opened, textured_plane
from PIL import ExifTags, Image

from datasets.clip import footage
from datasets.clip.clips import Clips
from datasets.files.errors import SceneError
from datasets.files.image_files import read_rgba
from datasets.readers.video import open_source
from datasets.settings import SceneConfig
from datasets.video_files.image_folder import image_paths
from rasterizer.camera import Camera


def test_images_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    images = frames(14)
    for i, image in enumerate(images):
        cv2.imwrite(str(tmp_path / f"shot{i}.png"), image[..., ::-1])  # shot10 after shot9, not after shot1
    clip, _ = opened(tmp_path)
    assert all((frame.image == image).all() for frame, image in zip(clip.frames, images, strict=True))


@pytest.mark.parametrize(
    "names, expected",
    [
        ([f"{i:04d}" for i in range(14)], list(range(14))),
        ([f"shot_{10 * i + 5}" for i in range(14)], list(range(14))),  # every tenth frame of a video
        ([f"{i}" for i in range(14) if i not in (4, 5)], [i for i in range(14) if i not in (4, 5)]),  # two are missing
        ([f"{1305031102 + i * 0.05:.6f}" for i in range(14)], list(range(14))),  # seconds
        ([f"b{i}" if i else "a" for i in range(14)], list(range(14))),  # not all have a number
        ([f"{i:02d}_cam1" for i in range(14)], list(range(14))),  # the last number is no frame's
    ],
)
def test_times_are_the_numbers_in_the_names(tmp_path: Path, names: list[str], expected: list[int]) -> None:
    """In units of the usual step, a thirtieth of a second."""
    for name, image in zip(names, frames(len(names))):
        cv2.imwrite(str(tmp_path / f"{name}.png"), image[..., ::-1])
    clip, _ = opened(tmp_path)
    # 1e-4 of a step: names that are seconds have six digits behind the point
    found = 30 * np.array([frame.time for frame in clip.frames])
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_names_with_digits_that_are_no_numbers(tmp_path: Path) -> None:
    for name in ("a10.png", "a9.png", "a²1.png"):
        (tmp_path / name).touch()
    assert [path.name for path in image_paths(tmp_path)] == ["a9.png", "a10.png", "a²1.png"]


def stored_with_orientation(image: np.ndarray, orientation: int) -> np.ndarray:
    """EXIF: 1 to 8 say which sides of the upright image the file's row 0 and column 0 are: 1 top and left, 2 top and
    right, 3 bottom and right, 4 bottom and left; 5 to 8 left, right, right, left and top, top, bottom, bottom."""
    rows = image[::-1] if orientation in (3, 4, 7, 8) else image
    both = rows[:, ::-1] if orientation in (2, 3, 6, 7) else rows
    return np.ascontiguousarray(both.swapaxes(0, 1) if orientation > 4 else both)


@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_photographs_are_turned_as_their_exif_says(tmp_path: Path, suffix: str) -> None:
    images = frames(16)
    for i, image in enumerate(images):
        exif = Image.Exif()
        exif[ExifTags.Base.Orientation] = 1 + i % 8
        Image.fromarray(stored_with_orientation(image, 1 + i % 8)).save(tmp_path / f"{i:02d}.{suffix}", exif=exif)
    clip, _ = opened(tmp_path)
    assert all((frame.image == image).all() for frame, image in zip(clip.frames, images, strict=True))
    if suffix == "png":  # known poses are of the pixels as stored; Pillow turns TIFF itself
        stored = read_rgba(tmp_path / "05.png")[..., :3]
        assert (stored == stored_with_orientation(images[5], 6)).all() and stored.shape == (*SIZE, 3)


def test_transparent_pixels_have_the_background(tmp_path: Path) -> None:
    """Both of the frames and of the scene, whose background is black without the setting."""
    images = frames(14)
    for i, image in enumerate(images):
        alpha = np.full((*image.shape[:2], 1), 255, np.uint8)
        alpha[20:40, 30:60] = 0
        cv2.imwrite(str(tmp_path / f"{i:02d}.png"), np.concatenate([image[..., ::-1], alpha], axis=2))
    for setting, color in (("auto", (0, 0, 0)), ("white", (1, 1, 1)), ([1, 0, 0.2], (1, 0, 0.2))):
        cfg = SceneConfig("clip", "video", str(tmp_path), background=setting, downscale=1)
        clips = open_source(cfg, 1, lambda line: None).clips
        clip = clips.cameras[0]
        assert (clip.frames[3].image[20:40, 30:60] == np.multiply(color, 255)).all()
        assert (clip.frames[3].image[:20] == images[3][:20]).all()
        cameras = {f.name: Camera(*SIZE, 90, 90, 48, 32, moved(i)) for i, f in enumerate(clip.frames)}
        assert clips.to_scene(cameras, dict.fromkeys(cameras, 0.0), 1.0).background == color


def moved(x: float) -> np.ndarray:
    """The pose of a camera that looks along z, `x` to the left of the origin."""
    pose = np.eye(4)
    pose[0, 3] = x
    return pose


@pytest.mark.parametrize("downscale, width", [(1, 1301), (2, 650), (0, 433)])
def test_wide_frames_are_never_enlarged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, downscale: int, width: int
) -> None:
    """Structure from motion sees 650 pixels of 1301; its camera, 100 pixels of focal length, is that of the view."""
    monkeypatch.setattr(footage, "SFM_AREA", 650 * 227)
    images = [textured_plane(9 * i, (1301, 400))[:399] for i in range(14)]
    for i, image in enumerate(images):
        cv2.imwrite(str(tmp_path / f"{i:02d}.png"), image[..., ::-1])
    clip, _ = opened(tmp_path, downscale=downscale)
    cameras = {}
    for i, frame in enumerate(clip.frames):
        assert clip.photograph(frame).shape == (199, 650, 3)
        cameras[frame.name] = Camera(650, 199, 100.0, 100.0, 325.0, 99.5, moved(i))
    found = Clips(tmp_path, (clip,), (), SceneConfig("clip", "video", test_every=8))
    view = found.to_scene(cameras, dict.fromkeys(cameras, 0.0), 1.0).train[0]
    factor = downscale or 3
    whole = images[0][: 399 // factor * factor, : 1301 // factor * factor]
    if factor < 3:  # of 3, 650 pixels are scaled to 433
        small = whole.reshape(399 // factor, factor, width, factor, 3).mean(axis=(1, 3))
        assert np.abs(np.asarray(view.image) - small).max() <= 0.5
    assert np.asarray(view.image).shape == (399 // factor, width, 3) and view.camera.width == width
    assert view.camera.fx == pytest.approx(200 / factor, rel=2e-3)
    assert view.camera.cx == pytest.approx(650 / factor, rel=2e-3)


@pytest.mark.parametrize(
    "size, reduced",
    [((1242, 375), 1), ((1408, 376), 1), ((1280, 720), 2), ((1920, 1080), 2), ((3840, 2160), 4), ((1024, 1024), 1)],
)
def test_wide_pictures_of_cars_keep_their_size_for_structure_from_motion(size: tuple[int, int], reduced: int) -> None:
    assert footage._sfm_reduction(size) == reduced


def test_images_that_cannot_be_read_are_refused_with_the_reason(tmp_path: Path) -> None:
    for i, image in enumerate(frames(14)):
        cv2.imwrite(str(tmp_path / f"{i:02d}.png"), image.astype(np.uint16) * 256)
    with pytest.raises(SceneError, match=r"00\.png: expected 8 bits a channel, found image mode RGB;16B"):
        opened(tmp_path)


def test_images_of_two_sizes_are_no_clip(tmp_path: Path) -> None:
    for i, image in enumerate(frames(14)):
        cv2.imwrite(str(tmp_path / f"{i}.png"), image[:-2] if i == 5 else image)
    with pytest.raises(SceneError, match=r"5\.png: expected 96 x 64 pixels, the size of 0\.png, found 96 x 62 pixels"):
        opened(tmp_path)
