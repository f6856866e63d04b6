"""Videos of several cameras whose stored pixels are no picture yet: high dynamic range, pixels that are not square."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import plenoptic_folder
import pytest
from plenoptic_folder import (
    BLOCK,
    FRAMES,
    HEIGHT,
    RATE,
    WIDTH,
    inside,
    picture,
    pose_row,
    read,
    write_camera,
    write_video,
)

from datasets.plenoptic.footage import Footage
from datasets.scene import Scene, View
from rasterizer.camera import Camera

SIGNALS = np.array([40, 100, 148, 190])  # of 255
PQ = ("-pix_fmt", "yuv420p10le", "-x264-params", "transfer=smpte2084:colorprim=bt2020:colormatrix=bt2020nc")
CODEC = 4  # see test_plenoptic_videos.py
NAMES = ("cam00", "cam01", "cam02")


def bars(frame: int) -> np.ndarray:
    """(HEIGHT, WIDTH, 3) uint8: four bars of grey, another order in each frame."""
    row = np.roll(SIGNALS, frame).repeat(BLOCK).astype(np.uint8)
    return np.ascontiguousarray(np.broadcast_to(row[None, :, None], (HEIGHT, WIDTH, 3)))


def shown(signal: np.ndarray) -> np.ndarray:
    """sRGB of 255 of grey PQ signals of 255: ITU-R BT.2100's EOTF in cd/m², 203 of which are white, 1.6 times as
    bright, under Reinhard's curve that 1000 cd/m² are the white of (datasets/video_files/hdr.py)."""
    power = (signal / 255) ** (32 / 2523)
    light = 1e4 * (np.maximum(power - 107 / 128, 0) / (2413 / 128 - 2392 / 128 * power)) ** (8192 / 1305)
    x, white = 1.6 * light / 203, 1.6 * 1000 / 203
    return 255 * (1.055 * (x * (1 + x / white**2) / (1 + x)) ** (1 / 2.4) - 0.055)


def write_hdr(folder: Path) -> Path:
    folder.mkdir()
    for name in NAMES:
        write_video(folder / f"{name}.mp4", [bars(frame) for frame in range(FRAMES)], RATE, *PQ)
    np.save(folder / "poses_bounds.npy", np.stack([pose_row(number) for number in range(len(NAMES))]))
    return folder


def opened(folder: Path, **options: object) -> tuple[Footage, list[str]]:
    """The footage, and what was said of it."""
    lines: list[str] = []
    source = plenoptic_folder.opened(folder, "video", folder.parent / "own", log=lines.append, **options)
    return source.footage, lines


def scene_of(footage: Footage) -> Scene:
    cameras = {}
    for stream in footage.streams:
        pose = np.eye(4)
        pose[0, 3] = -stream.number
        cameras[stream.name] = Camera(*footage.size, 50, 50, footage.size[0] / 2, footage.size[1] / 2, pose)
    return footage.to_scene(cameras)


def check_bars(view: View) -> None:
    """A level of the signal's 876 of limited range is 0.4 of 255 at most; the rest is the codec's."""
    expected = shown(np.roll(SIGNALS, int(view.name[-4:])))
    found = np.asarray(view.image)[4:-4].reshape(HEIGHT - 8, len(SIGNALS), BLOCK, 3)[:, :, 4:-4]
    assert np.abs(found - expected[None, :, None, None]).max() <= CODEC, view.name


@pytest.mark.parametrize("first_frame", [0, 2])
def test_high_dynamic_range_is_mapped_with_poses_and_without(tmp_path: Path, first_frame: int) -> None:
    assert (np.abs(shown(SIGNALS) - SIGNALS) > 3 * CODEC).all()  # the signals themselves would not do
    folder = write_hdr(tmp_path / "hdr")
    footage, lines = opened(folder, downscale=1, first_frame=first_frame, frames=3)
    assert lines == [f"{name}.mp4: PQ (HDR10): highlights are compressed to 8-bit colour (BT.709)" for name in NAMES]
    for scene in (scene_of(footage), read(folder, first_frame=first_frame, frames=3)):
        assert [view.name[-4:] for view in scene.test] == [f"{first_frame + i:04d}" for i in range(3)]
        for view in scene.train + scene.test:
            check_bars(view)


def test_pixels_are_made_square_unless_poses_are_known(tmp_path: Path) -> None:
    """Half as wide again as high: 64 x 48 pixels are shown as 96 x 48. Poses are of the 64 x 48."""
    folder = tmp_path / "wide"
    folder.mkdir()
    for number, name in enumerate(NAMES):
        write_camera(folder / f"{name}.mp4", number, FRAMES, RATE, "-vf", "setsar=3/2")
    np.save(folder / "poses_bounds.npy", np.stack([pose_row(number) for number in range(len(NAMES))]))
    footage, lines = opened(folder, downscale=1)
    assert footage.size == (96, HEIGHT)
    assert lines == [
        f"{name}.mp4: pixels are 1.5 times as wide as high: frames are scaled to 96 x 48" for name in NAMES
    ]
    for number, image in enumerate(footage.first_images().values()):
        blocks = image.reshape(HEIGHT, 4, 24, 3)[:, :, 8:16]  # the middle third of each block of 24
        truth = picture(number, 0)[:, ::BLOCK, None]
        error = np.abs(blocks.astype(int) - truth).reshape(HEIGHT // BLOCK, BLOCK, -1)[:, 4:12]
        assert error.max() <= CODEC
    for view in read(folder).train:
        camera, frame = view.name.split("/cam")[1].split("_")
        assert view.image.shape == (HEIGHT, WIDTH, 3)
        assert (
            np.abs(inside(np.asarray(view.image)).astype(int) - inside(picture(int(camera), int(frame)))).max() <= CODEC
        )
