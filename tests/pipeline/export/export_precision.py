"""How exactly exported files show a trained model: PSNR of each format, read back, against the kernel's images.

    PYTHONPATH=tests/pipeline/export python -m export_precision RUN [RUN …]

Prints Markdown. The files are read by export_readers.py and rendered by the kernel: three test views at three times.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from export_readers import (
    in_time,
    read_fourdgs,
    read_ftgs,
    read_glb,
    read_ply,
    read_splat,
    read_splatv,
    read_spz,
    static_at,
)

from pipeline.data.training_views import evenly_spaced
from pipeline.evaluation.image_metrics import psnr
from pipeline.evaluation.renderer import Renderer
from pipeline.export.formats import FILM, FORMATS, FRAME
from pipeline.export.pieces import film_of
from pipeline.export.source import PLAYED_SECONDS, Timeline
from pipeline.export.splats import frame_at
from pipeline.model.model import Model
from pipeline.trained.open_run import TrainedRun, open_run
from rasterizer import Rasterizer

FRAME_READERS = {"ply": read_ply, "splat": read_splat, "spz": read_spz, "glb": read_glb}
FILM_READERS = {
    "ftgs.ply": read_ftgs,
    "splatv": read_splatv,
    "4dgs": lambda content: read_fourdgs(content, PLAYED_SECONDS),
}
SHARES = (0.2, 0.5, 0.8)  # of the scene's duration


def rows(run: TrainedRun) -> dict[str, tuple[float, float]]:
    """Format -> (PSNR in dB, mean over views and times; MB a file)."""
    scene = run.scene
    line = Timeline(scene.time_start, scene.duration, camera=scene.train[0].camera)
    times = [scene.time_start + share * scene.duration for share in SHARES]
    cameras = [scene.test[i].camera for i in evenly_spaced(len(scene.test), 3)]

    def images(model_at: Callable[[float], Model]) -> list[np.ndarray]:
        rendered = (Renderer(model_at(time), scene, run.cfg, Rasterizer()) for time in times)
        return [renderer.image(camera, time) for time, renderer in zip(times, rendered) for camera in cameras]

    def score(model_at: Callable[[float], Model]) -> float:
        return float(np.mean([psnr(image, truth) for image, truth in zip(images(model_at), kernel)]))

    plain = Model.from_gaussians(run.model.gaussians())  # no static format has a background model
    kernel = images(lambda time: plain)
    frames = {time: frame_at(plain, time, scene.duration) for time in times}
    found = {}
    for name, form in FORMATS.items():
        if form.holds == FRAME:
            files = {time: form.content(frame) for time, frame in frames.items()}
            read = FRAME_READERS[name]
            found[name] = score(lambda time, read=read, files=files: read(files[time])), size_of(files.values())
        elif form.holds == FILM:
            content = form.content(film_of(plain, line, form.windows), line)
            film = in_time(FILM_READERS[name](content), line)
            found[name] = score(lambda time, film=film: static_at(film, time)), size_of([content])
    return found


def size_of(contents) -> float:
    return float(np.mean([len(content) for content in contents])) / 1e6


def main(folders: list[str]) -> None:
    runs = [open_run(Path(folder), lambda line: None) for folder in folders]
    found = [rows(run) for run in runs]
    heads = [f"{run.cfg.scene.name}, {len(run.model):,} Gaussians" for run in runs]
    print("| format | " + " | ".join(f"{head}: dB | MB" for head in heads) + " |")
    print("| -- |" + " -- | -- |" * len(runs))
    for name in found[0]:
        cells = [f"{quality:.1f} | {size:.2f}" for quality, size in (table[name] for table in found)]
        print(f"| {name} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main(sys.argv[1:])
