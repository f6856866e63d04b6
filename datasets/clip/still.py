"""Whether the camera of a video stands still: the picture's textured part stays where it is."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from datasets.clip.survey import small_image
from datasets.files.errors import SceneError
from datasets.video_files.decode import IMAGE_RATE, video_frames
from datasets.video_files.probe import probe

SAMPLES = 9  # frames, evenly spread
SHIFTED = 1.0  # pixels of the small images. Flow between frames of a tripod is below a tenth.
# Of the samples: a single one may be filled by somebody who walks past the lens.
MOVED_SHARE = 0.3
LEAST_TEXTURE = 3.0  # of 255: standard deviation around a pixel, below which its flow is a guess


def stands_still(path: Path) -> bool:
    """Whether the median displacement against the first frame is small in most frames of a video.

    True where no frame can be decoded: reading the video says so, with what to do.
    """
    try:
        return _still(path, path.stat().st_mtime_ns)
    except SceneError:
        return True


@lru_cache(maxsize=64)  # a run asks several times
def _still(path: Path, modified: int) -> bool:
    header = probe(path)
    total = header.count or round((header.seconds or 0.0) * (header.rate or IMAGE_RATE))
    wanted = set(np.linspace(0, max(total - 1, 0), SAMPLES).astype(int).tolist())
    frames = [frame.image for frame in video_frames(path, header, wanted) if frame.image is not None]
    images = [small_image(cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY)) for frame in frames]
    shifts = [_shift(images[0], image) for image in images[1:]]
    return not shifts or float(np.mean(np.array(shifts) > SHIFTED)) < MOVED_SHARE


def _shift(first: np.ndarray, image: np.ndarray) -> float:
    """Median displacement of the textured pixels, pixels; 0 without texture."""
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    flow = np.asarray(search.calc(first, image, None))  # type: ignore[call-overload]
    values = first.astype(np.float32)
    mean, square = (cv2.blur(x, (7, 7)) for x in (values, values**2))
    textured = square - mean**2 > LEAST_TEXTURE**2
    return float(np.median(np.linalg.norm(flow, axis=2)[textured])) if textured.any() else 0.0
