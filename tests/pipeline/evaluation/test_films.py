"""Videos, decoded by OpenCV: frames, frame rate and codec."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import imageio_ffmpeg
import numpy as np
import pytest
from tiny import SIZE, evaluation_config
from tiny_film import RATE, tiny_film

from pipeline.evaluation.evaluate import evaluate_with_images
from pipeline.evaluation.metrics import MeasuredView
from pipeline.evaluation.pictures.films import held_out_films, video
from pipeline.model.initialise import initialise

# Mean error of these small images by H.264 at QUALITY and chroma at half resolution, of 255. Measured: up to 2.4.
ENCODING_ERROR = 3.6


def smooth(height: int, width: int, number: int) -> np.ndarray:
    """(H, W, 3) in [0, 1]: a smooth image that moves with the frame number, different in each channel."""
    y, x = np.mgrid[:height, :width]
    waves = [0.5 + 0.4 * np.sin((x + number) / 25), 0.5 + 0.4 * np.cos(y / 20), (x + y) / (height + width)]
    return np.stack(waves, axis=-1).astype(np.float32)


def read(path: Path) -> tuple[list[np.ndarray], float, str]:
    """Frames (H, W, 3) RGB in 0..255, frames per second, and the codec's four-character code."""
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
def test_frames_rate_and_codec_of_a_written_video(tmp_path: Path, height: int, width: int, rate: float) -> None:
    write(tmp_path / "a.mp4", height, width, rate=rate)
    frames, found_rate, codec = read(tmp_path / "a.mp4")
    assert (len(frames), codec) == (12, "h264") and found_rate == pytest.approx(rate, abs=1e-3)
    for number, frame in enumerate(frames):
        assert frame.shape == (height + height % 2, width + width % 2, 3)  # odd sides are padded by one pixel
        assert np.abs(frame[:height, :width] - 255 * smooth(height, width, number)).mean() < ENCODING_ERROR


def test_the_pixel_format_is_supported_by_browsers(tmp_path: Path) -> None:
    write(tmp_path / "a.mp4", 48, 64)
    output = subprocess.run([imageio_ffmpeg.get_ffmpeg_exe(), "-i", tmp_path / "a.mp4"], capture_output=True, text=True)
    assert "h264" in output.stderr and "yuv420p(tv, bt709" in output.stderr


def test_the_same_images_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.mp4", "b.mp4"):
        write(tmp_path / name, 48, 64)
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()


def test_an_unfinished_video_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(KeyError), video(tmp_path / "a.mp4", 64, 48, 24.0) as send:
        send(smooth(48, 64, 0))
        raise KeyError
    assert list(tmp_path.iterdir()) == []


def test_images_of_another_size_are_refused(tmp_path: Path) -> None:
    refused = pytest.raises(ValueError, match=r"expected images of \(48, 64, 3\), found \(64, 48, 3\)")
    with refused, video(tmp_path / "a.mp4", 64, 48, 24.0) as send:
        send(smooth(64, 48, 0))


def test_an_encoder_that_exits_early_is_one_line(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("pipeline.evaluation.pictures.films._ENCODER", ("-no-such-option", "1"))
    with pytest.raises(OSError, match="a.mp4: expected .* f(ound|rames)"):
        write(tmp_path / "a.mp4", 480, 640, frames=50)
    assert list(tmp_path.iterdir()) == []


def test_one_video_per_camera(tmp_path: Path) -> None:
    with held_out_films(tmp_path, 24.0) as film:
        for camera, frames in (("cam00", 5), ("cam07", 3)):
            for number in range(frames):
                film(camera, MeasuredView(*(smooth(48, 64, n) for n in (number, 100 + number))))
    assert {path.name for path in tmp_path.iterdir()} == {f"{name}_render_and_truth.mp4" for name in ("cam00", "cam07")}
    assert [len(read(tmp_path / f"{name}_render_and_truth.mp4")[0]) for name in ("cam00", "cam07")] == [5, 3]
    for number, frame in enumerate(read(tmp_path / "cam07_render_and_truth.mp4")[0]):
        assert np.abs(frame[:, :64] - 255 * smooth(48, 64, number)).mean() < ENCODING_ERROR
        assert np.abs(frame[:, 64:] - 255 * smooth(48, 64, 100 + number)).mean() < ENCODING_ERROR


def test_videos_of_an_evaluation(tmp_path: Path) -> None:
    """Every frame of every held-out camera, render beside ground truth, and the bullet-time video."""
    scene, cfg = tiny_film(frames=5, height=SIZE + 1), evaluation_config(renders=-1)
    model = initialise(scene, cfg, np.random.default_rng(0))
    found = evaluate_with_images(model, scene, cfg, 2, tmp_path)
    assert [row["view"] for row in found.per_image] == [view.name for view in scene.test]
    for camera in ("cam00", "cam05"):
        frames, rate, _ = read(tmp_path / f"{camera}_render_and_truth.mp4")
        assert (len(frames), rate, frames[0].shape) == (5, RATE, (SIZE + 2, 2 * SIZE, 3))
        for number, frame in enumerate(frames):
            for part, half in (("render", frame[:-1, :SIZE]), ("truth", frame[:-1, SIZE:])):
                exact = cv2.imread(str(tmp_path / f"test_{camera}_{number:04d}_{part}.png"))[..., ::-1]
                assert np.abs(half - exact).mean() < ENCODING_ERROR
    frames, rate, _ = read(tmp_path / "bullet_time.mp4")
    assert (len(frames), rate, frames[0].shape) == (150, 30.0, (SIZE + 2, SIZE, 3))
    assert np.mean([np.abs(a - b).mean() for a, b in zip(frames, frames[1:])]) > 0  # the camera moves


@pytest.mark.parametrize("videos, frame_rate", [(False, RATE), (True, None)])
def test_no_videos_if_disabled_or_of_photographs(
    tmp_path: Path, monkeypatch, videos: bool, frame_rate: float | None
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)  # importing the encoder fails
    scene, cfg = replace(tiny_film(), frame_rate=frame_rate), evaluation_config(videos=videos)
    evaluate_with_images(initialise(scene, cfg, np.random.default_rng(0)), scene, cfg, 1, tmp_path)
    assert {path.suffix for path in tmp_path.iterdir()} == {".png"}
