"""Writes folders in the Plenoptic Video layout with small videos, and reads them."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from imageio_ffmpeg import get_ffmpeg_exe

from datasets.scene import Scene
from datasets.settings import SceneConfig
from datasets.source import Source, open_source

WIDTH, HEIGHT = 64, 48
FRAMES = 6
RATE = 30
BLOCK = 16
FOCAL = 50.0
NEAR, FAR = 2.0, 10.0


def picture(camera: int, frame: int, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """(height, width, 3) uint8 RGB: blocks of 16 × 16 pixels in colours that depend on camera and frame."""
    rng = np.random.default_rng([camera, frame])
    colours = rng.integers(40, 216, (-(-height // BLOCK), -(-width // BLOCK), 3), dtype=np.uint8)
    return colours.repeat(BLOCK, axis=0).repeat(BLOCK, axis=1)[:height, :width]


def inside(image: np.ndarray, downscale: int = 1) -> np.ndarray:
    """The middle quarter of each block: chroma subsampling blurs the edges."""
    side = BLOCK // downscale
    rows, columns = (np.arange(n) % side for n in image.shape[:2])
    kept = [(side // 4 <= part) & (part < 3 * side // 4) for part in (rows, columns)]
    return image[np.ix_(*kept)]


def write_video(path: Path, frames: Sequence[np.ndarray], rate: float = RATE, *options: str) -> None:
    """H.264, nearly lossless, only key frames, index first, so that a truncated file can be decoded."""
    height, width = frames[0].shape[:2]
    raw = f"-v error -y -f rawvideo -pix_fmt rgb24 -s {width}x{height} -r {rate} -i -"
    encoded = "-c:v libx264 -preset ultrafast -threads 1 -crf 1 -g 1 -pix_fmt yuv420p -movflags +faststart"
    command = [get_ffmpeg_exe(), *raw.split(), *encoded.split(), *options, str(path)]
    subprocess.run(command, input=b"".join(frame.tobytes() for frame in frames), check=True)


def write_camera(
    path: Path,
    camera: int,
    frames: int = FRAMES,
    rate: float = RATE,
    *options: str,
    width: int = WIDTH,
    height: int = HEIGHT,
) -> None:
    write_video(path, [picture(camera, frame, width, height) for frame in range(frames)], rate, *options)


def pose_row(x: float, size: tuple[int, int] = (WIDTH, HEIGHT), focal: float = FOCAL) -> np.ndarray:
    """LLFF's row (17,) of a camera at (x, 0, -4) with viewing direction +z, right +x and down +y."""
    columns = [[0, 1, 0], [1, 0, 0], [0, 0, -1], [x, 0, -4], [size[1], size[0], focal]]  # down, right, back, …
    return np.concatenate([np.array(columns, dtype=float).T.ravel(), [NEAR, FAR]])


def write_folder(root: Path, numbers: Sequence[int] = (0, 1, 2)) -> Path:
    """cam00.mp4 … and poses_bounds.npy; camera n is at x = n."""
    root.mkdir(parents=True, exist_ok=True)
    for number in numbers:
        write_camera(root / f"cam{number:02d}.mp4", number)
    np.save(root / "poses_bounds.npy", np.stack([pose_row(number) for number in numbers]))
    return root


def read(folder: Path, **options: object) -> Scene:
    """The scene with settings for small folders; frames are cached beside the folder."""
    return opened(folder, **options).scene()


def opened(
    folder: Path,
    reader: str = "plenoptic",
    cache: str | Path | None = None,
    threads: int = 2,
    log: Callable[[str], None] = lambda text: None,
    **options: object,
) -> Source:
    """The source; nothing is decoded. cache: beside the folder without one."""
    cache = str(cache or folder.parent / "cache")
    given = {"name": f"{reader}/toy", "downscale": 1, "cache": cache, **options}
    cfg = SceneConfig(reader=reader, path=str(folder), **given)
    return open_source(cfg, threads=threads, log=log)
