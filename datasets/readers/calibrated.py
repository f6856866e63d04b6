"""Reader of synchronised videos or images of cameras whose calibration is in a file (scene.calibration).

    DIR/NAME.mp4 or DIR/NAME/….mp4       a video a camera (datasets/plenoptic)
    DIR/NAME/0001.png, …, or DIR/NAME.png     images in order, or one a camera (datasets/photographs)

datasets/calibrations reads the file; its names are those of the videos, images or folders.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from datasets.calibrations.moving import FEWEST_TIMES, FRAMES, middles, small_frames
from datasets.calibrations.named import filmed, matched, photographed
from datasets.calibrations.read import read_calibration
from datasets.calibrations.readings import checked
from datasets.cameras.lens import Lens
from datasets.canonical import canonical_space
from datasets.composition import BLACK, compose
from datasets.files.contents import contents
from datasets.files.errors import SceneError
from datasets.files.image_files import common_size, read_rgba
from datasets.photographs.photograph import PosedFile
from datasets.photographs.scene import to_scene
from datasets.plenoptic.filmed import footage_of, read_videos, videos_config
from datasets.plenoptic.footage import Footage
from datasets.plenoptic.unsynchronised import is_synchronised, offsets_of
from datasets.plenoptic.videos import Video
from datasets.readers.plenoptic import PosedFootage
from datasets.scene import Scene
from datasets.settings import SceneConfig
from datasets.source import Log, PosedImages, Source, data_folder
from datasets.sync.offsets import Offsets
from datasets.video_files.film import Film
from rasterizer.camera import Camera

Calibrated = dict[str, tuple[Camera, Lens | None]]


def open_source(cfg: SceneConfig, threads: int, log: Log) -> Source:
    root = data_folder(cfg)
    files = filmed(root)
    if not files:
        return PosedImages(cfg, lambda: read(root, cfg, log))
    cfg = videos_config(cfg)
    if list(cfg.test_cameras) == [0] and all(file.number for file in files):
        first = min((f.number for f in files if f.number not in cfg.drop_cameras), default=0)
        cfg = replace(cfg, test_cameras=[first])
    log("cameras: " + ", ".join(f"{file.number} {file.name}" for file in files))
    videos = read_videos(root, files, cfg, threads, square=False)  # calibrated as the pixels are stored
    footage = footage_of(root, files, videos, _offsets(root, videos, cfg, log), cfg, threads, log)
    named = {video.name: _words(video.name, video.path) for video in videos}
    paths = {video.name: video for video in videos}
    found = calibrated(
        cfg, named, {name: v.film.size for name, v in paths.items()}, lambda name: _frames(paths[name].film, cfg), log
    )
    found = {name: _covering(*one, footage) for name, one in found.items()}
    cameras = {name: camera for name, (camera, _) in found.items()}
    trained = [camera for name, camera in cameras.items() if name not in footage.held_out]
    lenses = {name: lens for name, (_, lens) in found.items() if lens}
    return PosedFootage(cfg, footage, cameras, lenses, unit=canonical_space(trained).unit)


def read(root: Path, cfg: SceneConfig, log: Log) -> Scene:
    """The scene of images."""
    folders = photographed(root)
    if not folders:
        raise SceneError(root, "videos or images, or a folder of them a camera", contents(root))
    sizes = {name: common_size(paths) for name, paths in folders.items()}
    named = {name: _words(name, paths[0]) for name, paths in folders.items()}
    found = calibrated(cfg, named, sizes, lambda name: _images(folders[name]), log)
    several = any(len(paths) > 1 for paths in folders.values())
    photographs = [
        PosedFile(
            f"{name}_{path.stem}" if several else name, path, *found[name], group=number, folder=name, moment=path.stem,
            time=None if several else 0.0,
        )
        for number, (name, paths) in enumerate(folders.items())
        for path in paths
    ]  # fmt: skip
    return to_scene(root, photographs, cfg, log)


def calibrated(
    cfg: SceneConfig,
    named: dict[str, str],
    sizes: dict[str, tuple[int, int]],
    images: Callable[[str], list[np.ndarray]],
    log: Log,
) -> Calibrated:
    """Camera and lens of each file or folder of `named` (name -> words that name its camera), of images of `sizes`.

    images: a few frames, of equal times in all.
    """
    assert cfg.calibration is not None
    path = Path(cfg.calibration).expanduser()
    rig = read_calibration(path)
    for note in rig.notes:
        log(note)
    by_name = {camera.name: camera for camera in rig.cameras}
    owner = matched(list(by_name), named, str(path), log)
    found = {name: by_name[owner[name]].of(sizes[name], named[name]) for name in named}

    def moving() -> dict[str, np.ndarray] | None:
        frames = {name: images(name) for name in found}
        if min(map(len, frames.values())) < FEWEST_TIMES:
            return None
        return {name: middles(small_frames(frames[name], *found[name])) for name in found}

    cameras = checked(rig, {name: camera for name, (camera, _) in found.items()}, str(path), log, moving)
    return {name: (cameras[name], lens) for name, (_, lens) in found.items()}


def _frames(film: Film, cfg: SceneConfig) -> list[np.ndarray]:
    """Evenly spread frames in use; none where one is damaged."""
    last = min(film.count, cfg.first_frame + cfg.frames) - 1
    wanted = set(np.linspace(min(cfg.first_frame, last), last, FRAMES).astype(int).tolist())
    found = [frame.image for frame in film.frames(wanted)]
    return [image for image in found if image is not None] if all(image is not None for image in found) else []


def _images(paths: Sequence[Path]) -> list[np.ndarray]:
    chosen = np.unique(np.linspace(0, len(paths) - 1, FRAMES).astype(int))
    return [compose(read_rgba(paths[index]), BLACK) for index in chosen]


def _words(name: str, path: Path) -> str:
    return path.stem if path.stem == name else f"{name}/{path.stem}"


def _offsets(root: Path, videos: Sequence[Video], cfg: SceneConfig, log: Log) -> Offsets | None:
    """Of cameras that did not start together; None for those of one rate and length, whose rig has one trigger."""
    films = [video.film for video in videos]
    one_trigger = len({(film.count, round(film.rate, 2)) for film in films}) == 1
    if cfg.sync == "none" or (cfg.sync == "auto" and one_trigger):
        return None
    offsets = offsets_of(root, videos, cfg.sync, cfg.offsets, log)
    return None if offsets is None or is_synchronised(videos, offsets) else offsets


def _covering(camera: Camera, lens: Lens | None, footage: Footage) -> tuple[Camera, Lens | None]:
    """Of the footage's frames, to which films of another size are scaled and cut (plenoptic/align.py)."""
    width, height = footage.size
    if (camera.width, camera.height) == (width, height):
        return camera, lens
    scale = max(width / camera.width, height / camera.height)
    larger = max(width, round(camera.width * scale)), max(height, round(camera.height * scale))
    scaled = camera.resized(*larger)
    left, top = (larger[0] - width) // 2, (larger[1] - height) // 2
    cut = replace(scaled, width=width, height=height, cx=scaled.cx - left, cy=scaled.cy - top)
    return cut, lens and lens.scaled_to(cut)
