"""Writes H.264 videos (4:2:0, .mp4) frame by frame, without keeping frames in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType

import numpy as np

from datasets.files.atomic_write import atomic_file
from pipeline.data.frame_order import camera_name

# x264's constant rate factor, 0 (lossless) to 51; 18 is visually lossless. No metric is computed from a video.
QUALITY = 18

# The colour matrix is written to the file, because players otherwise guess it from the image size. With one thread the
# output does not depend on the machine; rendering and measuring, which run in parallel, take longer than encoding.
_ENCODER = (
    "-vf", "scale=in_range=full:out_range=limited:out_color_matrix=bt709",
    "-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709", "-color_range", "tv",
    "-crf", str(QUALITY), "-threads", "1", "-fflags", "+bitexact", "-flags:v", "+bitexact", "-movflags", "+faststart",
)  # fmt: skip

Send = Callable[[np.ndarray], None]  # takes the next image, (H, W, 3) in [0, 1]


@contextmanager
def video(path: Path, width: int, height: int, frame_rate: float) -> Iterator[Send]:
    """Write the images sent, width × height each, as a video at `frame_rate` frames per second.

    Odd sides are padded with a copy of the last pixels. The write is atomic. Raises OSError if the encoder fails, and
    ValueError for an image of another size.
    """
    from imageio_ffmpeg import count_frames_and_secs, write_frames  # not imported where no video is written

    even = (width + width % 2, height + height % 2)  # 4:2:0 stores chroma for every second pixel
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
        encoder.send(None)  # starts the encoder

        def send(image: np.ndarray) -> None:
            nonlocal sent
            if image.shape != (height, width, 3):
                raise ValueError(f"{path}: expected images of {(height, width, 3)}, found {image.shape}")
            pixels = np.round(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8)
            padded = np.pad(pixels, ((0, even[1] - height), (0, even[0] - width), (0, 0)), mode="edge")
            try:
                encoder.send(np.ascontiguousarray(padded))
            except OSError as error:
                raise OSError(f"{path}: expected ffmpeg to accept frame {sent}, found that it had exited") from error
            sent += 1

        try:
            yield send
        finally:
            encoder.close()  # waits for the last frames
        # write_frames hides the exit status of the encoder; a disk that fills up at the end would go unnoticed.
        written = count_frames_and_secs(str(temporary))[0] if temporary.exists() else 0
        if written != sent:
            raise OSError(f"{path}: expected {sent} frames written, found {written}")


class HeldOutFilms:
    """Writes <camera>_render_and_truth.mp4 for each test camera: render left, ground truth right. A context manager.

    Call it with every test view's name and images in film order (frame_order.film_order).
    """

    def __init__(self, folder: Path, frame_rate: float) -> None:
        self._folder, self._frame_rate = folder, frame_rate
        self._camera: str | None = None
        self._open = ExitStack()  # the video of `_camera`
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
            self._open.close()  # finishes the previous camera's video
            self._camera = camera_name(view_name)
            path = self._folder / f"{self._camera}_render_and_truth.mp4"
            self._send = self._open.enter_context(video(path, pair.shape[1], pair.shape[0], self._frame_rate))
        assert self._send is not None
        self._send(pair)
