"""Videos of an evaluation: H.264 (4:2:0, .mp4), written frame by frame, without keeping frames in memory."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

from datasets.files.atomic_write import atomic_file
from datasets.scene import View
from pipeline.data.training_views import camera_at, target_of
from pipeline.evaluation.metrics import MeasuredView, SeeView
from pipeline.evaluation.pictures.camera_path import FRAME_RATE, Ellipse, bullet_time, ellipse_among, median_depth
from pipeline.evaluation.renderer import Renderer
from rasterizer import Camera

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


@contextmanager
def held_out_films(folder: Path, frame_rate: float) -> Iterator[SeeView]:
    """Write <camera>_render_and_truth.mp4 for each test camera: render left, ground truth right.

    To be called with the camera of every test view, camera by camera in the order of time.
    """
    before, send = "", None
    with ExitStack() as opened:

        def show(camera: str, seen: MeasuredView) -> None:
            nonlocal before, send
            pair = np.concatenate([seen.image, seen.truth], axis=1)
            if send is None or camera != before:
                opened.close()  # finishes the previous camera's video
                before = camera
                path = folder / f"{camera}_render_and_truth.mp4"
                send = opened.enter_context(video(path, pair.shape[1], pair.shape[0], frame_rate))
            send(pair)

        yield show


def path_of(renderer: Renderer) -> tuple[Ellipse, Camera]:
    """The ellipse among the training cameras, and a camera with the intrinsics of its images."""
    scene, scale = renderer.scene, renderer.cfg.train.resolution_scale
    cameras, intrinsics = [view.camera for view in scene.train], camera_at(scene.test[0].camera, scale)
    points, sphere = renderer.model.parameters["mean"][:, :3], renderer.model.sphere
    depth = median_depth((points if sphere is None else points[~sphere]).numpy(), intrinsics)
    return ellipse_among(cameras, default_depth=depth or scene.extent), intrinsics


def write_bullet_time(path: Path, renderer: Renderer) -> None:
    """A video along camera_path's ellipse among the training cameras, with the intrinsics of the first test camera."""
    scene = renderer.scene
    ellipse, intrinsics = path_of(renderer)
    with video(path, intrinsics.width, intrinsics.height, FRAME_RATE) as send:
        for frame in bullet_time(ellipse, intrinsics, scene.time_start, scene.duration):
            send(renderer.image(frame.camera, frame.time))


def write_clip_films(folder: Path, renderer: Renderer, frame_rate: float) -> None:
    """Three videos of cameras that move: path_render_and_truth.mp4, every frame beside its render (held-out ones
    included, one camera after the other, in order of time); still_camera.mp4, all times of one camera seen by its
    middle frame; and bullet_time.mp4."""
    scene, scale = renderer.scene, renderer.cfg.train.resolution_scale

    places = Counter(view.camera.world_to_cam.tobytes() for view in scene.train + scene.test)

    def taker(view: View) -> str:
        place = view.camera.world_to_cam.tobytes()
        return view.filmed_by or (
            place.hex() if places[place] > 1 else ""
        )  # a held-out camera that stands still beside a clip

    views = sorted(scene.train + scene.test, key=lambda view: (taker(view), view.time))
    middle = views[len(views) // 2]
    still = camera_at(middle.camera, scale)
    width, height = still.width, still.height
    with video(folder / "path_render_and_truth.mp4", 2 * width, height, frame_rate) as send:
        for view in views:
            target = target_of(view, scale)
            image = renderer.image(target.camera, target.time)
            send(np.concatenate([image, target.image.numpy().transpose(1, 2, 0)], axis=1))
    with video(folder / "still_camera.mp4", width, height, frame_rate) as send:
        for view in views:
            if taker(view) == taker(middle):
                send(renderer.image(still, view.time))
    write_bullet_time(folder / "bullet_time.mp4", renderer)
