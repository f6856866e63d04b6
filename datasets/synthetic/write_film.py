"""Renders a scene with a camera rig and writes it in the Plenoptic Video layout, atomically.

camNN.mp4              H.264, video.FRAME_RATE frames a second; frame i is the world at time i / FRAME_RATE
poses_bounds.npy       (N, 17) float64, LLFF's convention, see llff_row
truth/camNN_depth.npy  (H, W) float32 depth z at the pixels' centres of frame 0, world units
truth/camNN.npz        moving, depth, flow, flow_valid of every frame, flow_dt, see datasets/ground_truth.py
meta.json              the arguments that made the scene
"""

from __future__ import annotations

import importlib
import multiprocessing
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from datasets.files.atomic_write import atomic_folder, write_json
from datasets.files.errors import SceneError
from datasets.synthetic.film import depth_of, film, write_film_truth
from datasets.synthetic.rig import rig
from datasets.synthetic.video import FRAME_RATE, write_video
from datasets.synthetic.world import World
from rasterizer.camera import Camera

SMALLEST = 16  # image width in pixels: one macroblock of H.264
# Depths beyond this are background and excluded from the far bounds: 20 × the rig's distance to its focus.
BACKDROP = 60.0


@dataclass(frozen=True)
class FilmSettings:
    """The arguments of a film. World and cameras cannot be pickled: worker processes rebuild them from these."""

    scene: str  # module in datasets/synthetic/scenes
    seed: int
    size: int  # width of the images in pixels, even
    cameras: int
    frames: int
    samples: int  # rays along a pixel's side, odd

    def __post_init__(self) -> None:
        if self.size < SMALLEST or self.size % 2:  # chroma subsampling needs even sizes
            raise SceneError("scene.size", f"an even number, at least {SMALLEST}", str(self.size))
        if self.frames < 1:
            raise SceneError("scene.frames", "at least 1", str(self.frames))
        if self.samples < 1 or self.samples % 2 == 0:
            raise SceneError("samples", "an odd number of rays along a pixel's side", str(self.samples))

    @property
    def height(self) -> int:
        """¾ of the width, rounded to an even number of pixels."""
        return 2 * round(3 * self.size / 8)

    @property
    def times(self) -> np.ndarray:
        """(frames,) seconds."""
        return np.arange(self.frames) / FRAME_RATE

    def set_up(self) -> tuple[World, list[Camera]]:
        # Separate generators: the cameras of a seed do not change when a scene draws more random numbers.
        world_rng, rig_rng = np.random.default_rng(self.seed).spawn(2)
        world = importlib.import_module(f"datasets.synthetic.scenes.{self.scene}").build(world_rng)
        return world, rig(self.cameras, self.size, self.height, rig_rng)


def write_film(
    settings: FilmSettings, folder: Path, *, processes: int = 1, progress: Callable[[int, int], None] | None = None
) -> Path:
    """Renders all cameras into `folder`, `processes` of them in parallel; the bytes do not depend on `processes`."""
    if processes < 1:
        raise SceneError("processes", "at least 1", str(processes))
    _, cameras = settings.set_up()
    with atomic_folder(folder, marker="meta.json") as temporary:
        (temporary / "truth").mkdir()
        with _mapper(processes) as unordered_map:
            for done, _ in enumerate(
                unordered_map(partial(_film_camera, settings, temporary), range(settings.cameras)), 1
            ):
                if progress is not None:
                    progress(done, settings.cameras)
        depths = [np.load(_depth_path(temporary, number)) for number in range(settings.cameras)]
        near_far = [(depth.min(), depth[depth < BACKDROP].max()) for depth in depths]
        np.save(
            temporary / "poses_bounds.npy",
            np.stack([llff_row(camera, *bounds) for camera, bounds in zip(cameras, near_far)]),
        )
        write_json(
            temporary / "meta.json",
            {
                **asdict(settings),
                "frame_rate": FRAME_RATE,
                "backdrop": BACKDROP,
                "depth": "z along the viewing axis, frame 0",
            },
        )
    return folder


def llff_row(camera: Camera, near: float, far: float) -> np.ndarray:
    """A row (17,) of poses_bounds.npy: the matrix [R | t | (height, width, focal)] (3, 5) row by row, near, far.

    R's columns are the camera's down, right and backward axes in the world, t its centre; focal in pixels.
    """
    right, down, forward = camera.world_to_cam[:3, :3]
    matrix = np.stack([down, right, -forward, camera.position, [camera.height, camera.width, camera.fx]], axis=-1)
    return np.concatenate([matrix.ravel(), [near, far]])


def _film_camera(settings: FilmSettings, folder: Path, number: int) -> int:
    """Writes one camera's video and ground truth; returns its number."""
    world, cameras = settings.set_up()
    camera = cameras[number]
    np.save(_depth_path(folder, number), depth_of(world, camera, settings.times[0]))
    write_film_truth(folder / "truth" / f"cam{number:02d}.npz", world, camera, settings.times, 1 / FRAME_RATE)
    write_video(
        folder / f"cam{number:02d}.mp4",
        film(world, camera, settings.times, samples=settings.samples),
        camera.width,
        camera.height,
    )
    return number


def _depth_path(folder: Path, number: int) -> Path:
    return folder / "truth" / f"cam{number:02d}_depth.npy"


@contextmanager
def _mapper(processes: int) -> Iterator[Callable]:
    """A map() in this process, or in `processes` processes with results in order of completion."""
    if processes == 1:
        yield map
        return
    # Spawned: a fork hangs after a parallel region of torch or numpy.
    with ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn")) as pool:

        def unordered_map(task: Callable, items: range) -> Iterator:
            futures = [pool.submit(task, item) for item in items]
            try:
                for future in as_completed(futures):
                    yield future.result()
            finally:
                pool.shutdown(wait=True, cancel_futures=True)  # after a failure the rest is cancelled

        yield unordered_map
