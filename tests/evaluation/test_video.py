"""Videos read back by another program's decoder: what was written, how much of it, and how fast."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import imageio_ffmpeg
import numpy as np
import pytest
from test_evaluate import config
from tiny import SIZE
from tiny_film import RATE, tiny_film

from pipeline.evaluation.evaluate import evaluate_and_show
from pipeline.evaluation.films import HeldOutFilms, video
from pipeline.model.initialise import initialise

# H.264 at QUALITY, and colours at half resolution: mean error of these small images, levels of 255. Measured: to 2.4.
LOSS = 3.6


def smooth(height: int, width: int, number: int) -> np.ndarray:
    """(H, W, 3) in [0, 1]: slow waves that move with the frame's number; each channel its own."""
    y, x = np.mgrid[:height, :width]
    waves = [0.5 + 0.4 * np.sin((x + number) / 25), 0.5 + 0.4 * np.cos(y / 20), (x + y) / (height + width)]
    return np.stack(waves, axis=-1).astype(np.float32)


def read(path: Path) -> tuple[list[np.ndarray], float, str]:
    """Frames (H, W, 3) RGB in levels of 255, frames a second, and the codec's four letters."""
    capture = cv2.VideoCapture(str(path))
    frames = []
    while (got := capture.read())[0]:
        frames.append(got[1][..., ::-1].astype(float))
    codec = int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little").decode()
    return frames, capture.get(cv2.CAP_PROP_FPS), codec


def write(path: Path, height: int, width: int, frames: int = 12, rate: float = 24.0) -> None:
    with video(path, width, height, rate) as send:
        for number in range(frames):
            send(smooth(height, width, number))


@pytest.mark.parametrize("height, width, rate", [(48, 64, 24.0), (45, 63, 29.97)])
def test_what_is_written_can_be_read(tmp_path: Path, height: int, width: int, rate: float) -> None:
    write(tmp_path / "a.mp4", height, width, rate=rate)
    frames, found_rate, codec = read(tmp_path / "a.mp4")
    assert (len(frames), codec) == (12, "h264") and found_rate == pytest.approx(rate, abs=1e-3)
    for number, frame in enumerate(frames):
        assert frame.shape == (height + height % 2, width + width % 2, 3)  # odd sides get one pixel more
        assert np.abs(frame[:height, :width] - 255 * smooth(height, width, number)).mean() < LOSS


def test_it_is_what_browsers_play(tmp_path: Path) -> None:
    write(tmp_path / "a.mp4", 48, 64)
    said = subprocess.run([imageio_ffmpeg.get_ffmpeg_exe(), "-i", tmp_path / "a.mp4"], capture_output=True, text=True)
    assert "h264" in said.stderr and "yuv420p(tv, bt709" in said.stderr


def test_the_same_images_make_the_same_file(tmp_path: Path) -> None:
    for name in ("a.mp4", "b.mp4"):
        write(tmp_path / name, 48, 64)
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()


def test_a_video_that_was_not_finished_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(KeyError), video(tmp_path / "a.mp4", 64, 48, 24.0) as send:
        send(smooth(48, 64, 0))
        raise KeyError
    assert list(tmp_path.iterdir()) == []


def test_images_of_another_size_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"expected images of \(48, 64, 3\), found \(64, 48, 3\)"):
        with video(tmp_path / "a.mp4", 64, 48, 24.0) as send:
            send(smooth(64, 48, 0))


def test_an_encoder_that_ends_early_is_one_line(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("pipeline.evaluation.films._ENCODER", ("-no-such-option", "1"))
    with pytest.raises(OSError, match="a.mp4: expected .* f(ound|rames)"):
        write(tmp_path / "a.mp4", 480, 640, frames=50)
    assert list(tmp_path.iterdir()) == []


def test_a_film_a_camera(tmp_path: Path) -> None:
    with HeldOutFilms(tmp_path, 24.0) as film:
        for camera, frames in (("cam00", 5), ("cam07", 3)):
            for number in range(frames):
                film(f"test/{camera}_{number:04d}", smooth(48, 64, number), smooth(48, 64, 100 + number))
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "cam00_render_and_truth.mp4",
        "cam07_render_and_truth.mp4",
    ]
    assert [len(read(tmp_path / f"{name}_render_and_truth.mp4")[0]) for name in ("cam00", "cam07")] == [5, 3]
    for number, frame in enumerate(read(tmp_path / "cam07_render_and_truth.mp4")[0]):
        assert np.abs(frame[:, :64] - 255 * smooth(48, 64, number)).mean() < LOSS
        assert np.abs(frame[:, 64:] - 255 * smooth(48, 64, 100 + number)).mean() < LOSS


def test_what_an_evaluation_films(tmp_path: Path) -> None:
    """Every frame of every held-out camera, render beside truth; and the bullet-time path."""
    scene, cfg = tiny_film(frames=5, height=SIZE + 1), config(renders=-1)
    model = initialise(scene, cfg, np.random.default_rng(0))
    found = evaluate_and_show(model, scene, cfg, 2, tmp_path)
    assert [row["view"] for row in found.per_image] == [view.name for view in scene.test]
    for camera in ("cam00", "cam05"):
        frames, rate, _ = read(tmp_path / f"{camera}_render_and_truth.mp4")
        assert (len(frames), rate, frames[0].shape) == (5, RATE, (SIZE + 2, 2 * SIZE, 3))
        for number, frame in enumerate(frames):
            for part, half in (("render", frame[:-1, :SIZE]), ("truth", frame[:-1, SIZE:])):
                exact = cv2.imread(str(tmp_path / f"test_{camera}_{number:04d}_{part}.png"))[..., ::-1]
                assert np.abs(half - exact).mean() < LOSS
    frames, rate, _ = read(tmp_path / "bullet_time.mp4")
    assert (len(frames), rate, frames[0].shape) == (150, 30.0, (SIZE + 2, SIZE, 3))
    assert np.mean([np.abs(a - b).mean() for a, b in zip(frames, frames[1:])]) > 0  # it moves


@pytest.mark.parametrize("videos, frame_rate", [(False, RATE), (True, None)])
def test_no_video_where_none_is_wanted_or_nothing_was_filmed(
    tmp_path: Path, monkeypatch, videos: bool, frame_rate: float | None
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)  # nor is the encoder needed: to import it fails
    scene, cfg = replace(tiny_film(), frame_rate=frame_rate), config(videos=videos)
    evaluate_and_show(initialise(scene, cfg, np.random.default_rng(0)), scene, cfg, 1, tmp_path)
    assert {path.suffix for path in tmp_path.iterdir()} == {".png"}
