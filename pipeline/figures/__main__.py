"""The paper's figures of a run, with a sentence on each: RUN/figures/.

flow.png        rendered optical flow, beside the true one or OpenCV's, and its end-point error
time_maps.png   where in time the Gaussians at each pixel live: distance from t, and deviation
lifetimes.png   histogram of the Gaussians' deviations in time
slices.png      a row of pixels over time
growth.png      number of Gaussians against the length of the video
paths.png       where Gaussians on shared trajectories go; they do not fade: this in place of the figures on lifetimes
film.png        new views along a path, of bullet_time.mp4
figures.md      all of them; `python -m pipeline.report` shows them too
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from datasets.files.atomic_write import atomic_file, write_json, write_text
from pipeline.evaluation.pictures.camera_path import bullet_time
from pipeline.evaluation.pictures.films import path_of, write_bullet_time
from pipeline.evaluation.renderer import Renderer
from pipeline.figures.figure import FILE, Figure, panels, png_of
from pipeline.figures.motion import flow_figure, most_moving, paths_figure
from pipeline.figures.slices import slices_figure
from pipeline.figures.time_distribution import growth_figure, lifetimes_figure, time_maps_figure
from pipeline.terminal.command_line import CommandParser, command, log
from pipeline.trained.open_run import TrainedRun, open_run
from rasterizer import engine_for
from rasterizer.cores import thread_count

FILM = "bullet_time.mp4"
FILM_FRAMES = 5  # of its strip, of each turn


@command
def main(arguments: list[str]) -> int:
    parser = CommandParser("figures", __doc__)
    parser.add_argument("run", type=Path, metavar="RUN", help="folder of a finished run")
    parser.add_argument("--out", type=Path, metavar="DIR", help="default: RUN/figures")
    parser.add_argument("--data", type=Path, metavar="DIR", help="where the data set is now (default: where it was)")
    other = "another run of the scene, as of no_4drot: its slices through time are drawn too"
    parser.add_argument("--beside", type=Path, metavar="RUN", help=other)
    options = parser.parse_args(arguments)
    run = open_run(options.run, log, options.data)
    renderer = renderer_of(run)
    beside = None
    if options.beside:
        found = open_run(options.beside, log, options.data)
        beside = (found.cfg.ablation.name, renderer_of(found))
    out = options.out or options.run / "figures"
    out.mkdir(parents=True, exist_ok=True)
    figures = []
    for figure in figures_of(renderer, out, beside):
        log(f"{figure.file}: {figure.seen}")
        with atomic_file(out / figure.file) as temporary:
            temporary.write_bytes(figure.png)
        figures.append(figure)
    page = markdown(f"{run.cfg.scene.name}, {run.cfg.ablation.name}, {run.cfg.train.name}", figures)
    write_json(out / FILE, [{"file": f.file, "title": f.title, "seen": f.seen} for f in figures])
    write_text(out / "figures.md", page)
    log(f"written to {out}")
    return 0


def renderer_of(run: TrainedRun) -> Renderer:
    return Renderer(run.model, run.scene, run.cfg, engine_for(run.cfg.backend, thread_count(run.cfg.threads)))


def figures_of(renderer: Renderer, folder: Path, beside: tuple[str, Renderer] | None = None) -> Iterator[Figure]:
    """A static model, which has no time, has new views only. beside: another model of the scene, for the slices."""
    if renderer.model.kind.motion != "static":
        view = most_moving(renderer)
        fade = renderer.model.trajectories is None
        yield flow_figure(renderer, view)
        yield from (time_maps_figure(renderer, view), lifetimes_figure(renderer)) if fade else ()
        yield slices_figure(renderer, view, beside)
        yield growth_figure(renderer) if fade else paths_figure(renderer, view)
    yield film_figure(renderer, folder)


def film_figure(renderer: Renderer, folder: Path) -> Figure:
    """Also writes the film into `folder`."""
    scene = renderer.scene
    write_bullet_time(folder / FILM, renderer)
    ellipse, intrinsics = path_of(renderer)
    path = bullet_time(ellipse, intrinsics, scene.time_start, scene.duration)
    chosen = [path[i] for i in np.linspace(0, len(path), 2 * FILM_FRAMES, endpoint=False).astype(int)]
    images = [(f"t = {frame.time:.2f}", renderer.image(frame.camera, frame.time)) for frame in chosen]
    seen = (
        f"{FILM}: once round among the training cameras while time stands still (above), then once more while it runs "
        "(below)."
    )
    return Figure("film", "New views", seen, png_of(panels(images, FILM_FRAMES)))


def markdown(title: str, figures: list[Figure]) -> str:
    parts = [f"## {figure.title}\n\n{figure.seen}\n\n![{figure.title}]({figure.file})\n" for figure in figures]
    return "\n".join([f"# {title}\n", *parts])


if __name__ == "__main__":
    sys.exit(main())
