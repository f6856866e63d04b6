"""One pass over a clip in small images: how sharp, bright and different the frames are, where it is cut, and its bars.

Nothing of a frame is kept but a few numbers, so that memory does not grow with the length of the clip. Of a long clip
SURVEYED_PER_FRAME times the frames in use are looked at, evenly spread. Fewer tell whether the camera stands still: a
good part of the picture's texture then stays where it is.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from datasets.files.errors import SceneError
from datasets.video_files.film import Film, open_film
from datasets.video_files.frame import Frame

WIDTH = 192  # pixels of the small images
# Frames looked at: so many for each that is used, for the sharpest of them, within two bounds.
SURVEYED_PER_FRAME, FEWEST_SURVEYED, MOST_SURVEYED = 8, 300, 2000
DARK, FLAT = 16.0, 4.0  # of 255: mean brightness and standard deviation of a frame that shows nothing
BAR_LEVEL = 24  # of 255: a bar's pixels are never brighter, TV range and its compression included
MOST_BAR = 0.4  # of a side
SAMPLES = 9  # frames, evenly spread
SHIFTED = 1.0  # pixels of the small images. Flow between frames of a tripod is below a tenth.
# Of the samples: a single one may be filled by somebody who walks past the lens.
MOVED_SHARE = 0.3
# Of the textured pixels: as many stay where they are if the camera does. Before a camera that moves 0 to 0.2 do (street
# from a car, hand-held shelf), before a still one at least 0.5 beside a person who fills the picture's height.
STAYING_SHARE = 0.25
LEAST_TEXTURE = 3.0  # of 255: standard deviation around a pixel, below which its flow is a guess


@dataclass(frozen=True)
class Survey:
    """A row for each frame looked at."""

    index: np.ndarray  # (N,) of the clip
    time: np.ndarray  # (N,) seconds
    good: np.ndarray  # (N,) bool: decoded
    sharpness: np.ndarray  # (N,) variance of the Laplacian / variance, of the small image; 0 if not good
    brightness: np.ndarray  # (N,) mean, of 255
    contrast: np.ndarray  # (N,) standard deviation, of 255
    flow: np.ndarray  # (N,) median displacement since the good frame before, image widths; 0 for the first
    unexplained: np.ndarray  # (N,) mean difference from that frame after its flow, in units of the contrast
    content: tuple[int, int, int, int]  # left, top, right, bottom of the image without bars, full-size pixels
    total: int  # frames of the clip that were decoded or damaged

    @property
    def dark(self) -> np.ndarray:
        """(N,) bool: frames of a fade that show nothing."""
        return (self.brightness < DARK) | (self.contrast < FLAT)


def survey(frames: Iterable[Frame], total: int) -> Survey | None:
    """Surveys the frames; None if none could be decoded. total: of the clip, damaged ones included."""
    rows: list[tuple[float, ...]] = []  # the columns of Survey
    before: np.ndarray | None = None
    brightest: np.ndarray | None = None  # of all frames, by pixel of the full size
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)
    for frame in frames:
        if frame.image is None:
            rows.append((frame.index, frame.time, 0, 0, 0, 0, 0, 0))
            continue
        grey = cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY)
        brightest = grey if brightest is None or brightest.shape != grey.shape else np.maximum(brightest, grey)
        small = small_image(grey)
        contrast = float(small.std())
        sharpness = float(cv2.Laplacian(small, cv2.CV_32F).var()) / max(contrast**2, 1.0)
        flow, unexplained = (0.0, 0.0) if before is None else _change(search, before, small)
        rows.append((frame.index, frame.time, 1, sharpness, float(small.mean()), contrast, flow, unexplained))
        before = small
    if brightest is None:
        return None
    table = np.array(rows, dtype=np.float64)
    index = table[:, 0].astype(int)
    total = max(total, int(index[-1]) + 1)
    sharpness, brightness, contrast, flow, unexplained = table[:, 3:].T
    numbers = sharpness, brightness, contrast, flow, unexplained
    return Survey(index, table[:, 1], table[:, 2] > 0, *numbers, _content(brightest), total)


def small_image(grey: np.ndarray) -> np.ndarray:
    """The image with at most WIDTH pixels on its longer side."""
    scale = WIDTH / max(grey.shape)
    if scale >= 1:
        return grey
    size = max(16, round(grey.shape[1] * scale)), max(16, round(grey.shape[0] * scale))
    return cv2.resize(grey, size, interpolation=cv2.INTER_AREA)


def _change(search: cv2.DISOpticalFlow, before: np.ndarray, small: np.ndarray) -> tuple[float, float]:
    """(median flow in image widths, what it leaves unexplained) between two small images.

    What is unexplained is |now - before after the flow|, with the brightness of both equalled: a fade is no cut.
    """
    flow = np.asarray(search.calc(small, before, None))  # type: ignore[call-overload]
    height, width = small.shape
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    warped = cv2.remap(before, x + flow[..., 0], y + flow[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    a, b = (image.astype(np.float32) for image in (small, warped))
    a, b = (a - a.mean()) / max(float(a.std()), 1.0), (b - b.mean()) / max(float(b.std()), 1.0)
    return float(np.median(np.linalg.norm(flow, axis=2))) / width, float(np.abs(a - b).mean())


def _content(brightest: np.ndarray) -> tuple[int, int, int, int]:
    """The rectangle without bars: rows and columns at the edges that are black in every frame."""
    left, right = _inside((brightest > BAR_LEVEL).mean(axis=0) > 0.02)
    top, bottom = _inside((brightest > BAR_LEVEL).mean(axis=1) > 0.02)
    return left, top, right, bottom


def _inside(lit: np.ndarray) -> tuple[int, int]:
    """(first, last + 1) of the lit rows; everything where the bars would take too much."""
    if not lit.any():
        return 0, len(lit)
    first, last = int(lit.argmax()), len(lit) - int(lit[::-1].argmax())
    return (first, last) if first <= MOST_BAR * len(lit) and len(lit) - last <= MOST_BAR * len(lit) else (0, len(lit))


def stands_still(path: Path, cache: Path) -> bool:
    """Whether enough of the picture stays where it was in the first frame, in most frames of a video: something large
    that moves close to a still camera leaves the rest in place.

    True where no frame can be decoded: reading the video says so, with what to do.
    """
    try:
        return _still(open_film(path, cache))
    except SceneError:
        return True


@lru_cache(maxsize=64)  # a run asks several times
def _still(film: Film) -> bool:
    wanted = set(np.linspace(0, film.count - 1, SAMPLES).astype(int).tolist())
    frames = [frame.image for frame in film.frames(wanted) if frame.image is not None]
    images = [small_image(cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY)) for frame in frames]
    shifts = [_shift(images[0], image) for image in images[1:]]
    return not shifts or float(np.mean(np.array(shifts) > SHIFTED)) < MOVED_SHARE


def _shift(first: np.ndarray, image: np.ndarray) -> float:
    """The displacement that STAYING_SHARE of the textured pixels are below, pixels; 0 without texture."""
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    flow = np.asarray(search.calc(first, image, None))  # type: ignore[call-overload]
    known = textured(first)
    return float(np.quantile(np.linalg.norm(flow, axis=2)[known], STAYING_SHARE)) if known.any() else 0.0


def textured(grey: np.ndarray) -> np.ndarray:
    """(H, W) bool: where flow can be measured."""
    values = grey.astype(np.float32)
    mean, square = (cv2.blur(x, (7, 7)) for x in (values, values**2))
    return square - mean**2 > LEAST_TEXTURE**2
