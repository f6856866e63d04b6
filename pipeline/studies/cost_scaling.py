"""How cost grows: python -m pipeline.studies.cost_scaling

Milliseconds of a frame (forward and backward) and of a training iteration (frames, loss, dense Adam) against the number
of Gaussians, the pixels, the batch and the length of the video, one at a time, on one thread's CPU time. Each series
gets the exponent e of cost = c · size^e, fitted by least squares in the logarithms: 1 is proportional, less is better
than that. How many Gaussians a longer video needs is another question: pipeline/studies/video_length.py.
"""

from __future__ import annotations

import argparse
import csv
import io
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib
import numpy as np
import torch
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from pipeline.presentation.theme import LIGHT
from pipeline.runs.provenance import provenance
from pipeline.terminal.closed_pipe import quiet_on_closed_pipe
from rasterizer import Gaussians
from rasterizer.memory import keep_freed_memory
from rasterizer.timing.measure import time_frame, time_iteration
from rasterizer.timing.workloads import WORKLOADS, Workload, make_workload

AXES = {
    "gaussians": "Gaussians",
    "pixels": "pixels",
    "batch": "views an iteration",
    "length": "length, as many Gaussians a second",
    "length_alone": "length, as many Gaussians in all",
}
_COLOURS = {"frame": LIGHT.ablations[0], "iteration": LIGHT.ablations[1]}


@dataclass(frozen=True)
class Series:
    """A cost measured at several sizes of one thing, all else the same."""

    axis: str  # in AXES
    cost: str  # frame or iteration
    sizes: tuple[int, ...]
    milliseconds: tuple[float, ...]  # CPU time of one thread, minimum of the repetitions

    def fit(self) -> tuple[float, float]:
        """(c, e) of milliseconds = c · size^e, by least squares of the logarithms."""
        e, log_c = np.polyfit(np.log(self.sizes), np.log(self.milliseconds), 1)
        return float(np.exp(log_c)), float(e)


def with_gaussians(workload: Workload, count: int) -> Workload:
    """The first `count`: the workloads draw theirs independently, so a part is the same scene, thinner."""
    rows = {name: tensor[:count].clone() for name, tensor in workload.gaussians.tensors().items()}
    return replace(workload, gaussians=Gaussians(**{"quat_right": None, **rows}))


def with_width(workload: Workload, width: int) -> Workload:
    """The same view in more or fewer pixels."""
    height = round(workload.camera.height * width / workload.camera.width)
    return replace(workload, camera=workload.camera.resized(width, height))


def with_length(workload: Workload, length: int) -> Workload:
    """A video `length` times as long, seen at its middle: Gaussians spread over it, each alive as long as before."""
    mean = workload.gaussians.mean.clone()
    mean[:, 3] *= length
    return replace(
        workload,
        gaussians=replace(workload.gaussians, mean=mean),
        time=workload.time * length,
        duration=workload.duration * length,
    )


def measure(
    workload: Workload, repeats: int, steps: int = 4, views: int = 4, log: Callable[[str], None] = lambda line: None
) -> list[Series]:
    """Gaussians halved, width halved and doubled, batch and length doubled, `steps` sizes each; iterations are of
    `views` views where the batch is not what is varied.

    Length twice: with as many Gaussians a second in each, the longest having the workload's; and with the workload's.
    """
    count, width = len(workload.gaussians), workload.camera.width
    smaller = [with_gaussians(workload, count >> k) for k in reversed(range(steps))]
    resized = [with_width(workload, (2 * width) >> k) for k in reversed(range(steps))]
    lengths = batches = [1 << k for k in range(steps)]
    longer = [with_length(w, length) for w, length in zip(smaller, lengths, strict=True)]
    thinner = [with_length(workload, length) for length in lengths]
    found = []
    for axis, workloads, sizes in (
        ("gaussians", smaller, [len(w.gaussians) for w in smaller]),
        ("pixels", resized, [w.camera.width * w.camera.height for w in resized]),
        ("length", longer, lengths),
        ("length_alone", thinner, lengths),
    ):
        log(axis)
        frame = tuple(time_frame(w, 1, repeats).total.minimum for w in workloads)
        iteration = tuple(time_iteration(w, 1, repeats, views)["iteration"].minimum for w in workloads)
        found += [Series(axis, "frame", tuple(sizes), frame), Series(axis, "iteration", tuple(sizes), iteration)]
    log("batch")
    iteration = tuple(time_iteration(workload, 1, repeats, b)["iteration"].minimum for b in batches)
    return [*found, Series("batch", "iteration", tuple(batches), iteration)]


def comma_separated(series: Sequence[Series]) -> str:
    """One measurement a line, the fit of its series beside it."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(["axis", "cost", "size", "milliseconds", "exponent"])
    for s in series:
        for size, ms in zip(s.sizes, s.milliseconds, strict=True):
            writer.writerow([s.axis, s.cost, size, ms, f"{s.fit()[1]:.4f}"])
    return buffer.getvalue()


def markdown(series: Sequence[Series], heading: str) -> str:
    """A row a series: its sizes, its milliseconds, its exponent."""
    lines = [
        "### How cost grows",
        "",
        heading,
        "",
        "| milliseconds of a | against | sizes | ms | exponent |",
        "|:---|:---|:---|:---|---:|",
    ]
    for s in series:
        lines.append(
            f"| {s.cost} | {AXES[s.axis]} | {', '.join(f'{n:,}' for n in s.sizes).replace(', ', ' · ')} | "
            f"{' · '.join(f'{ms:.1f}' for ms in s.milliseconds)} | {s.fit()[1]:.2f} |"
        )
    note = (
        "- CPU time of one thread, minimum. Exponent e: cost = c · size^e, least squares of the logarithms; 1 is "
        "proportional. A length of 2 is a video twice as long, in which each Gaussian lives as long as before: "
        "with as many a second as many are alive in a frame, with as many in all half as many."
    )
    return "\n".join([*lines, "", note]) + "\n"


def draw(series: Sequence[Series], title: str) -> str:
    """SVG text, a panel for each of AXES, logarithmic both ways; the same numbers give the same bytes."""
    with matplotlib.rc_context({"svg.hashsalt": "scaling", "font.family": "DejaVu Sans", "font.size": 9.5}):
        figure = Figure(figsize=(12.6, 7.4), facecolor="white")
        FigureCanvasSVG(figure)
        panels = list(
            figure.subplots(
                2, 3, gridspec_kw={"left": 0.05, "right": 0.985, "bottom": 0.08, "top": 0.92, "hspace": 0.32}
            ).flat
        )
        panels[-1].axis("off")  # five are drawn
        for axis, (key, label) in zip(panels, AXES.items()):
            for s in (s for s in series if s.axis == key):
                c, e = s.fit()
                axis.plot(s.sizes, s.milliseconds, "o", color=_COLOURS[s.cost])
                axis.plot(
                    s.sizes,
                    [c * size**e for size in s.sizes],
                    color=_COLOURS[s.cost],
                    label=f"{s.cost}: exponent {e:.2f}",
                )
            axis.set(xscale="log", yscale="log", xlabel=label)
            axis.set_title("ms, CPU time of one thread", loc="left", fontsize=10)
            axis.grid(color=LIGHT.faint, which="both", lw=0.7)
            axis.legend(frameon=False)
        figure.text(0.05, 0.97, title, fontsize=9)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


@quiet_on_closed_pipe()
def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m pipeline.studies.cost_scaling", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--workload", choices=WORKLOADS, default="W1", help="the largest scene of the series (W1)")
    parser.add_argument("--repeats", type=int, default=9, help="fastest of so many (9)")
    parser.add_argument("--out", type=Path, default=Path("results/scaling"), help="(results/scaling)")
    options = parser.parse_args(arguments)
    if options.repeats < 1:
        parser.error(f"--repeats: expected at least 1, found {options.repeats}")
    keep_freed_memory()
    torch.set_num_threads(1)
    series = measure(make_workload(options.workload), options.repeats, log=lambda line: print(line, flush=True))
    typed = sys.argv[1:] if arguments is None else arguments
    made = provenance(" ".join(["python -m pipeline.studies.cost_scaling", *typed]))
    heading = (
        f"{options.workload}. {made['machine']}; {made['date'][:16]}; commit {made['git_commit'][:10]}; "
        f"`{made['command']}`."
    )
    options.out.mkdir(parents=True, exist_ok=True)
    for suffix, content in (
        ("csv", comma_separated(series)),
        ("md", markdown(series, heading)),
        ("svg", draw(series, f"{options.workload}, {made['machine']}, {made['date'][:10]}")),
    ):
        (options.out / f"scaling.{suffix}").write_text(content, encoding="utf-8")
    print(markdown(series, heading))
    print(f"written to {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
