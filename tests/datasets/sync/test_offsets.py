"""Starts of cameras that were not synchronised: films of a synthetic scene at four rates, with and without sound."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from clips import SOUND_RATE, write_clip

from datasets.readers.video import read_footage
from datasets.settings import SceneConfig
from datasets.sync.offsets import Offsets, find_offsets, offsets_of, with_drift
from datasets.sync.signals import Signal, picture_signals
from datasets.synthetic.film import film
from datasets.synthetic.rig import rig
from datasets.synthetic.scenes import counter
from datasets.video_files.film import open_film

RATES = (24.0, 25.0, 30000 / 1001, 60.0)
SECONDS = 6.0


def films(root: Path, starts: np.ndarray) -> list[Path]:
    """A film a rate, of 48 x 36 pixels; all hear one track, each at its own level and with noise of its own."""
    rng = np.random.default_rng(7)
    world = counter.build(np.random.default_rng(0))
    cameras = rig(len(RATES), 48, 36, np.random.default_rng(1))
    track = 0.02 * rng.standard_normal(8 * SOUND_RATE)
    for at in rng.integers(0, len(track) - 4800, 20):
        track[at : at + 4800] += rng.uniform(0.1, 0.5) * rng.standard_normal(4800) * np.exp(-np.arange(4800) / 600)
    paths = []
    for number, (camera, rate, start) in enumerate(zip(cameras, RATES, starts)):
        times = np.arange(int(SECONDS * rate)) / rate
        part = track[round(start * SOUND_RATE) : round((start + SECONDS) * SOUND_RATE)]
        heard = np.clip(rng.uniform(0.3, 1) * part + 0.005 * rng.standard_normal(len(part)), -1, 1)
        frames = film(world, camera, times + start, samples=1)
        paths.append(write_clip(root / f"cam{number}.mp4", frames, times.tolist(), heard))
    return paths


@pytest.fixture(scope="module")
def starts() -> np.ndarray:
    return np.random.default_rng(3).uniform(0, 1.2, len(RATES))


@pytest.fixture(scope="module")
def with_sound(tmp_path_factory: pytest.TempPathFactory, starts: np.ndarray) -> list[Path]:
    return films(tmp_path_factory.mktemp("sound"), starts)


def test_by_sound_within_two_milliseconds(with_sound: list[Path], starts: np.ndarray) -> None:
    found = find_offsets([open_film(path, path.parent) for path in with_sound])
    assert found is not None and found.method == "sound" and found.drift == (0.0,) * len(RATES)
    np.testing.assert_allclose(found.seconds, starts - starts[0], atol=2e-3)


def test_by_the_picture_within_half_a_frame(with_sound: list[Path], starts: np.ndarray) -> None:
    """The same films without their sound."""
    found = offsets_of([picture_signals(open_film(path, path.parent)) for path in with_sound], "picture")
    assert found is not None and found.method == "picture"
    np.testing.assert_allclose(found.seconds, starts - starts[0], atol=0.5 / max(RATES[:3]))


def test_frames_keep_their_own_times(with_sound: list[Path], starts: np.ndarray) -> None:
    """Real times, between the ticks of the common clock; nothing is rounded to a frame."""
    footage = read_footage(with_sound[0].parent, SceneConfig("x", "video", sync="auto"), 1, lambda line: None)
    assert {stream.count for stream in footage.streams} == {footage.count} and footage.rate == pytest.approx(
        24, rel=0.01
    )
    world_time = [start + np.array(s.indices) / rate for start, rate, s in zip(starts, RATES, footage.streams)]
    origin = min(times[0] for times in world_time)
    for stream, times in zip(footage.streams, world_time):
        np.testing.assert_allclose(stream.times, times - origin, atol=2e-3)  # of the offsets


def test_given_offsets_are_used(with_sound: list[Path]) -> None:
    lines: list[str] = []
    cfg = SceneConfig("x", "video", sync="given", offsets=[1.0, 1.5, 1.0, 1.0])
    footage = read_footage(with_sound[0].parent, cfg, 1, lines.append)
    assert "cam1 +500.0 ms" in lines[0]
    assert footage.streams[0].indices[0] == 12 and footage.streams[1].indices[0] == 0  # half a second of 24 a second
    with pytest.raises(ValueError, match="scene.offsets: expected 4 numbers"):
        read_footage(with_sound[0].parent, replace(cfg, offsets=[1.0]), 1, lines.append)


def test_a_drifting_clock_is_found() -> None:
    """The second clock runs fast by 50 ppm and starts 0.5 s late; pulses of 1 ms steps over two minutes."""
    rng = np.random.default_rng(0)
    events = rng.uniform(1, 119, 600)
    drift, start = 5e-5, 0.5

    def heard(times: np.ndarray) -> Signal:
        values = np.zeros(120_000)
        np.add.at(values, np.clip((1e3 * times).astype(int), 0, len(values) - 1), 1.0)
        return Signal(0.0, 1e-3, np.convolve(values, np.hanning(9), "same"))

    late = events[events > start]
    signals = heard(events), heard((late - start) * (1 + drift))
    first = Offsets((0.0, start - 60 * drift), (0.0, 0.0), "sound", (9.0, 9.0), 0.0)
    found = with_drift(first, signals)
    assert found.drift[1] == pytest.approx(-drift, abs=1e-5)  # a millisecond's step over two minutes: 8 ppm
    assert found.seconds[1] == pytest.approx(start, abs=2e-3)


@pytest.mark.parametrize("cameras", [2, 4])
def test_noise_alone_is_not_trusted(cameras: int) -> None:
    rng = np.random.default_rng(0)
    signals = [[Signal(0.0, 1e-3, rng.standard_normal(4000))] for _ in range(cameras)]
    assert offsets_of(signals, "sound") is None


def test_short_recordings_that_have_nothing_in_common_are_refused() -> None:
    """Parts of 3 s of one motion, none of which overlap: by chance some agree well at a wrong lag."""
    rng = np.random.default_rng(0)
    for _ in range(100):
        motion = np.convolve(rng.standard_normal(9_000), np.hanning(100), "same")
        signals = [[Signal(0.0, 1 / 480, motion[first : first + 1440])] for first in (0, 3_000, 6_000)]
        assert offsets_of(signals, "picture") is None
