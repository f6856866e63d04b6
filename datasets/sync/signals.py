"""Signals of a video over time that other cameras of the same event have too."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import av
import av.error
import cv2
import numpy as np

from datasets.video_files.film import Film
from datasets.video_files.pictures import clock_start, open_container

SOUND_STEP = 1e-3  # seconds between values of the sound's energy
SOUND_RATE = 16_000  # samples a second that energy is measured from
SOUND_WINDOW = 64  # samples, 4 ms
PICTURE_STEP = 1 / 480  # seconds: a fraction of a frame
PICTURE_WIDTH = 64  # pixels
QUIET = 1e-4  # of full scale: below it a recording is silence
LONGEST = 600.0  # seconds of a recording that are used


@dataclass(frozen=True)
class Signal:
    """Values at start, start + step, … seconds of the video's own clock."""

    start: float
    step: float
    values: np.ndarray  # (N,) float64


def sound_energy(path: Path) -> Signal | None:
    """Log energy of the sound, without its slow changes; None without sound."""
    samples, start = _samples(path)
    if samples is None or len(samples) < SOUND_RATE or float(np.abs(samples).max()) < QUIET:
        return None
    power = np.convolve(samples.astype(np.float64) ** 2, np.ones(SOUND_WINDOW) / SOUND_WINDOW, "same")
    hop = round(SOUND_RATE * SOUND_STEP)
    return Signal(start, SOUND_STEP, _high_pass(np.log(power[::hop] + QUIET**2), round(1 / SOUND_STEP)))


def picture_signals(film: Film) -> list[Signal]:
    """[change of brightness, motion energy], both on a grid finer than frames."""
    times, brightness, energy, before = [], [], [], None
    for frame in film.frames():
        if frame.time - film.times[0] > LONGEST:
            break
        if frame.image is None:
            continue
        height = max(1, round(PICTURE_WIDTH * frame.image.shape[0] / frame.image.shape[1]))
        grey = cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY)
        small = cv2.resize(grey, (PICTURE_WIDTH, height), interpolation=cv2.INTER_AREA).astype(np.float32)
        if before is not None:
            times.append(0.5 * (frame.time + before[0]))  # a change belongs between two frames
            seconds = max(frame.time - before[0], 1e-3)
            brightness.append(float(small.mean() - before[1].mean()) / seconds)
            centred = (small - small.mean()) - (before[1] - before[1].mean())
            energy.append(float(np.abs(centred).mean()) / seconds)
        before = (frame.time, small)
    if len(times) < 8:
        return []
    grid = np.arange(times[0], times[-1], PICTURE_STEP)
    length = round(2 / PICTURE_STEP)
    return [
        Signal(times[0], PICTURE_STEP, _high_pass(np.interp(grid, times, values), length))
        for values in (brightness, energy)
    ]


def _samples(path: Path) -> tuple[np.ndarray | None, float]:
    """(mono samples in [-1, 1] at SOUND_RATE, time of the first on the clock of the video)."""
    parts, start = [], None
    with open_container(path) as container:
        if not container.streams.audio:
            return None, 0.0
        resampler = av.AudioResampler(format="flt", layout="mono", rate=SOUND_RATE)
        try:
            for frame in container.decode(container.streams.audio[0]):
                if start is None:
                    start = float(frame.time or 0.0) - clock_start(container)
                if (frame.time or 0.0) > LONGEST:
                    break
                parts += [resampled.to_ndarray()[0] for resampled in resampler.resample(frame)]
            parts += [resampled.to_ndarray()[0] for resampled in resampler.resample(None)]
        except av.error.FFmpegError:
            pass  # what came before the damage is used
    return (np.concatenate(parts), start or 0.0) if parts else (None, 0.0)


def _high_pass(values: np.ndarray, length: int) -> np.ndarray:
    """Without the moving average over `length` values; mean 0, standard deviation 1."""
    length = min(length, max(1, len(values) // 2))
    total = np.cumsum(np.pad(values, (length // 2 + 1, length - length // 2 - 1), mode="edge"))
    slow = np.concatenate([total[length:] - total[:-length], [total[-1] - total[-length]]])[: len(values)] / length
    rest = values - slow
    return (rest - rest.mean()) / max(float(rest.std()), 1e-12)
