"""Cost scaling: time of a frame and of a training iteration against the size of the scene.

A frame is a forward and a backward pass; an iteration is the frames of a batch, loss and dense Adam. Each is measured
against the number of Gaussians, the pixels, the batch and the length of the video, one at a time, as CPU time of one
thread. The exponent e of cost = c · size^e is fitted by least squares of the logarithms. How many Gaussians a longer
video needs is another study: pipeline/studies/video_length.py. Writes cost_scaling.csv, .md and .svg.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from pipeline.presentation.theme import LIGHT
from pipeline.studies.command_line import Provenance, StudyParser, log, study_command
from pipeline.studies.output import csv_text, svg_figure, svg_style, svg_text, write_results
from rasterizer import Gaussians
from rasterizer.allocator import keep_freed_memory
from rasterizer.timing.frame_time import time_frame
from rasterizer.timing.iteration_time import time_iteration
from rasterizer.timing.workloads import WORKLOADS, Workload, make_workload

NAME = "cost_scaling"
AXES = {
    "gaussians": "Gaussians",
    "pixels": "pixels",
    "batch": "views an iteration",
    "length": "video length at constant Gaussians a second",
    "length_alone": "video length at a constant number of Gaussians",
}
_COLOURS = {"frame": LIGHT.ablations[0], "iteration": LIGHT.ablations[1]}
_MARGINS = {"left": 0.05, "right": 0.985, "bottom": 0.08, "top": 0.92, "hspace": 0.32}


@dataclass(frozen=True)
class Series:
    """The cost at several sizes along one axis, all else equal."""

    axis: str  # in AXES
    cost: str  # frame or iteration
    sizes: tuple[int, ...]
    milliseconds: tuple[float, ...]  # CPU time of one thread, minimum of the repetitions

    def fit(self) -> tuple[float, float]:
        """(c, e) of milliseconds = c · size^e, by least squares of the logarithms."""
        e, log_c = np.polyfit(np.log(self.sizes), np.log(self.milliseconds), 1)
        return float(np.exp(log_c)), float(e)


def with_gaussians(workload: Workload, count: int) -> Workload:
    """The first `count` Gaussians. Workloads draw them independently: the same scene at a lower density."""
    rows = {name: tensor[:count].clone() for name, tensor in workload.gaussians.tensors().items()}
    return replace(workload, gaussians=Gaussians.from_tensors(rows))


def with_width(workload: Workload, width: int) -> Workload:
    """The same view at another resolution."""
    height = round(workload.camera.height * width / workload.camera.width)
    return replace(workload, camera=workload.camera.resized(width, height))


def with_length(workload: Workload, length: int) -> Workload:
    """A video `length` times as long, rendered at its middle: Gaussians are spread over it, lifetimes stay."""
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
    """All series, with `steps` sizes each: Gaussians and width are halved, batch and length doubled.

    Length is varied at constant Gaussians a second (the longest video has the workload's) and at the workload's number
    of Gaussians. Where the batch is not varied an iteration has `views` views.
    """
    count, width = len(workload.gaussians), workload.camera.width
    smaller = [with_gaussians(workload, count >> k) for k in reversed(range(steps))]
    resized = [with_width(workload, (2 * width) >> k) for k in reversed(range(steps))]
    lengths = batches = [1 << k for k in range(steps)]
    longer = [with_length(w, length) for w, length in zip(smaller, lengths, strict=True)]
    sparser = [with_length(workload, length) for length in lengths]
    found = []
    for axis, workloads, sizes in (
        ("gaussians", smaller, [len(w.gaussians) for w in smaller]),
        ("pixels", resized, [w.camera.width * w.camera.height for w in resized]),
        ("length", longer, lengths),
        ("length_alone", sparser, lengths),
    ):
        log(axis)
        frame = tuple(time_frame(w, 1, repeats).total.minimum for w in workloads)
        iteration = tuple(time_iteration(w, 1, repeats, views)["iteration"].minimum for w in workloads)
        found += [Series(axis, "frame", tuple(sizes), frame), Series(axis, "iteration", tuple(sizes), iteration)]
    log("batch")
    iteration = tuple(time_iteration(workload, 1, repeats, b)["iteration"].minimum for b in batches)
    return [*found, Series("batch", "iteration", tuple(batches), iteration)]


def comma_separated(series: Sequence[Series]) -> str:
    """One line for each measurement, with the exponent of its series."""
    return csv_text(
        ["axis", "cost", "size", "milliseconds", "exponent"],
        (
            [s.axis, s.cost, size, ms, f"{s.fit()[1]:.4f}"]
            for s in series
            for size, ms in zip(s.sizes, s.milliseconds, strict=True)
        ),
    )


def markdown(series: Sequence[Series], heading: str) -> str:
    """One row for each series: sizes, milliseconds, exponent."""
    lines = [
        "### Cost against scene size",
        "",
        heading,
        "",
        "| cost | against | sizes | ms | exponent |",
        "|:---|:---|:---|:---|---:|",
    ]
    for s in series:
        lines.append(
            f"| {s.cost} | {AXES[s.axis]} | {', '.join(f'{n:,}' for n in s.sizes).replace(', ', ' · ')} | "
            f"{' · '.join(f'{ms:.1f}' for ms in s.milliseconds)} | {s.fit()[1]:.2f} |"
        )
    note = (
        "- CPU time of one thread, minimum. Exponent e: cost = c · size^e, least squares of the logarithms; 1 is "
        "proportional. A length of 2 is a video twice as long with the same lifetimes of Gaussians. At constant "
        "Gaussians a second the number active in a frame stays; at a constant number of Gaussians it halves."
    )
    return "\n".join([*lines, "", note]) + "\n"


def draw(series: Sequence[Series], title: str) -> str:
    """SVG text, one panel for each of AXES, both axes logarithmic; the same numbers give the same bytes."""
    with svg_style(NAME):
        figure = svg_figure(12.6, 7.4)
        panels = list(figure.subplots(2, 3, gridspec_kw=_MARGINS).flat)
        panels[-1].axis("off")  # there are five
        for axis, (key, label) in zip(panels, AXES.items()):
            for s in (s for s in series if s.axis == key):
                c, e = s.fit()
                axis.plot(s.sizes, s.milliseconds, "o", color=_COLOURS[s.cost])
                fitted = [c * size**e for size in s.sizes]
                axis.plot(s.sizes, fitted, color=_COLOURS[s.cost], label=f"{s.cost}: exponent {e:.2f}")
            axis.set(xscale="log", yscale="log", xlabel=label)
            axis.set_title("ms, CPU time of one thread", loc="left", fontsize=10)
            axis.grid(color=LIGHT.faint, which="both", lw=0.7)
            axis.legend(frameon=False)
        figure.text(0.05, 0.97, title, fontsize=9)
        return svg_text(figure)


@study_command
def main(arguments: list[str]) -> int:
    parser = StudyParser(NAME, __doc__)
    parser.add_argument(
        "--workload", choices=WORKLOADS, default="W1", help="the largest scene of each series (default: %(default)s)"
    )
    parser.add_argument(
        "--repeats", type=int, default=9, metavar="N", help="repetitions; the minimum counts (default: %(default)s)"
    )
    options = parser.parse_args(arguments)
    parser.require(options.repeats >= 1, "--repeats", "at least 1", options.repeats)
    keep_freed_memory()
    torch.set_num_threads(1)
    series = measure(make_workload(options.workload), options.repeats, log=log)
    made = Provenance.of(NAME, arguments)
    table = markdown(series, f"{options.workload}. {made}.")
    written = write_results(
        options.out,
        {
            f"{NAME}.csv": comma_separated(series),
            f"{NAME}.md": table,
            f"{NAME}.svg": draw(series, f"{options.workload}, {made.short()}"),
        },
    )
    print(table)
    print(written)
    return 0


if __name__ == "__main__":
    sys.exit(main())
