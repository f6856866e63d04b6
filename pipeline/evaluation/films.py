"""Videos as any player takes them: H.264, 4:2:0, .mp4. Frames go to the encoder as they come; none is kept."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType

import numpy as np

from datasets.files.atomic_write import atomic_file
from pipeline.data.frame_order import camera_name

# x264's measure of loss, 0 to 51: to the eye there is none. No number is taken from a video.
QUALITY = 18

# The matrix is named in the file, or players guess one by the size of the image. What one thread writes does not depend
# on the machine; the encoder runs beside rendering and measuring, which take longer.
_ENCODER = (
    "-vf",
    "scale=in_range=full:out_range=limited:out_color_matrix=bt709",
    "-colorspace",
    "bt709",
    "-color_primaries",
    "bt709",
    "-color_trc",
    "bt709",
    "-color_range",
    "tv",
    "-crf",
    str(QUALITY),
    "-threads",
    "1",
    "-fflags",
    "+bitexact",
    "-flags:v",
    "+bitexact",
    "-movflags",
    "+faststart",
)

Send = Callable[[np.ndarray], None]  # takes the next image, (H, W, 3) in [0, 1]


@contextmanager
def video(path: Path, width: int, height: int, frame_rate: float) -> Iterator[Send]:
    """Write `path` from the images sent, width × height each; odd sides get their last pixels twice.

    The file appears when all is written, or not at all. OSError if the encoder fails.
    """
    from imageio_ffmpeg import count_frames_and_secs, write_frames  # only who writes a video needs it

    even = (width + width % 2, height + height % 2)  # 4:2:0 has a colour for every two pixels
    sent = 0
    with atomic_file(path) as temporary:
        encoder = write_frames(
            str(temporary),
            even,
            fps=frame_rate,
            codec="libx264",
            quality=None,
            macro_block_size=1,
            ffmpeg_log_level="error",
            output_params=list(_ENCODER),
        )
        encoder.send(None)  # starts it

        def send(image: np.ndarray) -> None:
            nonlocal sent
            if image.shape != (height, width, 3):
                raise ValueError(f"{path}: expected images of {(height, width, 3)}, found {image.shape}")
            pixels = np.round(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8)
            padded = np.pad(pixels, ((0, even[1] - height), (0, even[0] - width), (0, 0)), mode="edge")
            try:
                encoder.send(np.ascontiguousarray(padded))
            except OSError as error:
                raise OSError(f"{path}: expected ffmpeg to take frame {sent}, found it ended") from error
            sent += 1

        try:
            yield send
        finally:
            encoder.close()  # waits for the last frames
        # Its exit status is not to be had: a disk that filled up at the end would pass for success.
        written = count_frames_and_secs(str(temporary))[0] if temporary.exists() else 0
        if written != sent:
            raise OSError(f"{path}: expected {sent} frames written, found {written}")


class HeldOutFilms:
    """<camera>_render_and_truth.mp4 for each test camera, render left, truth right; a context manager.

    Called with every test view's name and images in film order (film.film_order).
    """

    def __init__(self, folder: Path, frame_rate: float) -> None:
        self._folder, self._frame_rate = folder, frame_rate
        self._camera: str | None = None
        self._open = ExitStack()  # the film of `camera`
        self._send: Send | None = None

    def __enter__(self) -> HeldOutFilms:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.__exit__(kind, error, trace)

    def __call__(self, view_name: str, image: np.ndarray, truth: np.ndarray) -> None:
        pair = np.concatenate([image, truth], axis=1)
        if camera_name(view_name) != self._camera:
            self._open.close()  # of the camera before
            self._camera = camera_name(view_name)
            path = self._folder / f"{self._camera}_render_and_truth.mp4"
            self._send = self._open.enter_context(video(path, pair.shape[1], pair.shape[0], self._frame_rate))
        self._send(pair)
