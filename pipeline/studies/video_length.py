"""Video length: Gaussians of trained models against the number of frames.

Reads runs that differ in scene.frames and seed only (python -m pipeline experiment=video_length trains them). The size
of a model grows with its Gaussians, the cost of a frame with those that are active in the frame. Exponents e are of
N = c · frames^e; the paper's appendix has such a figure. Writes video_length.csv, .md and .svg.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.presentation.seed_statistics import Estimate, estimate
from pipeline.presentation.table import measured
from pipeline.presentation.theme import LIGHT
from pipeline.runs.read.collect import Collection, collect
from pipeline.runs.read.variants import schedule_settings
from pipeline.studies.command_line import StudyParser, study_command
from pipeline.studies.output import csv_text, svg_figure, svg_style, svg_text, write_results

NAME = "video_length"
_KEY = "scene.frames"
_LINES = (("gaussians", "Gaussians"), ("alive", "active in a frame"))


@dataclass(frozen=True)
class Length:
    """All seeds of one video length. An estimate is None where a run lacks the value."""

    frames: int
    gaussians: Estimate
    alive: Estimate | None  # p(t) >= 0.05, mean over the test views
    psnr: Estimate | None  # dB, final
    seconds: Estimate | None  # of training


def lengths_of(collection: Collection) -> list[Length]:
    """Shortest first. ValueError, one line, where the runs differ in more than frames and seed, or do not in frames."""
    settings = collection.settings
    without = [run for run in collection.runs["run"] if _KEY not in settings[run]]
    if without:
        raise ValueError(f"{without[0]}: expected a config.yaml with {_KEY}, found none")
    others = {
        run: schedule_settings(settings[run]) | {"ablation": settings[run].get("ablation.name")}
        for run in collection.runs["run"]
    }
    first = next(iter(others))
    for run, found in others.items():
        differing = [
            key
            for key in found.keys() | others[first].keys()
            if key != _KEY and found.get(key) != others[first].get(key)
        ]
        if differing:
            raise ValueError(
                f"{run}: expected the settings of {first} except {_KEY} and seed, found another {min(differing)}"
            )
    frames = collection.runs["run"].map(lambda run: int(settings[run][_KEY]))
    lengths = [_length(count, runs) for count, runs in collection.runs.groupby(frames, sort=True)]
    if len(lengths) < 2:
        raise ValueError(f"{_KEY}: expected runs of at least two lengths, found only {lengths[0].frames}")
    return lengths


def _length(frames: int, runs: pd.DataFrame) -> Length:
    gaussians = estimate(runs["n_gaussians"])
    assert gaussians is not None  # metrics.json of every run has it: run_files.REQUIRED
    return Length(
        int(frames),
        gaussians,
        estimate(runs["n_alive_mean"]),
        estimate(runs["final.psnr"]),
        estimate(runs["train_seconds"]),
    )


def exponent(lengths: Sequence[Length], line: str) -> float:
    """e of `line` = c · frames^e, by least squares of the logarithms; NaN where a length lacks the value."""
    means = [np.nan if (value := getattr(length, line)) is None else value.mean for length in lengths]
    return float(np.polyfit(np.log([length.frames for length in lengths]), np.log(means), 1)[0])


def comma_separated(lengths: Sequence[Length]) -> str:
    """One line for each length: means, and the standard deviation over seeds where there are several."""
    columns = ("gaussians", "alive", "psnr", "seconds")
    rows = []
    for length in lengths:
        cells = []
        for value in (getattr(length, column) for column in columns):
            cells += ["", ""] if value is None else [value.mean, "" if np.isnan(value.std) else value.std]
        rows.append([length.frames, length.gaussians.n, *cells])
    return csv_text(["frames", "seeds", *(name for column in columns for name in (column, f"{column}_std"))], rows)


def markdown(lengths: Sequence[Length], heading: str) -> str:
    lines = [
        "### Gaussians against the length of a video",
        "",
        heading,
        "",
        "| frames | Gaussians | active in a frame | active fraction | PSNR, dB | train s |",
        "|---:|---:|---:|---:|---:|---:|",
    ]
    for length in lengths:
        fraction = f"{length.alive.mean / length.gaussians.mean:.2f}" if length.alive else "n/a"
        lines.append(
            f"| {length.frames:,} | {measured(length.gaussians, 0).text} | {measured(length.alive, 0).text} | "
            f"{fraction} | {measured(length.psnr).text} | {measured(length.seconds, 0).text} |"
        )
    exponents = "; ".join(f"{label} {exponent(lengths, line):z.2f}" for line, label in _LINES)
    note = f"- Exponents e of N = c · frames^e: {exponents}. ±: standard deviation over seeds; no ±: one seed."
    return "\n".join([*lines, "", note]) + "\n"


def draw(lengths: Sequence[Length], title: str) -> str:
    """SVG text, both axes logarithmic; the same numbers give the same bytes."""
    with svg_style(NAME):
        figure = svg_figure(7.2, 4.4)
        axis = figure.subplots(gridspec_kw={"left": 0.1, "right": 0.97, "bottom": 0.12, "top": 0.86})
        for (line, label), colour in zip(_LINES, LIGHT.ablations):
            shown = [(length.frames, value) for length in lengths if (value := getattr(length, line)) is not None]
            axis.errorbar(
                [frames for frames, _ in shown],
                [value.mean for _, value in shown],
                yerr=[np.nan_to_num(value.std) for _, value in shown],
                marker="o",
                color=colour,
                capsize=3,
                label=f"{label}: exponent {exponent(lengths, line):z.2f}",
            )
        axis.set(xscale="log", yscale="log", xlabel="frames")
        axis.set_xticks([length.frames for length in lengths], [str(length.frames) for length in lengths])
        axis.set_xticks([], minor=True)
        axis.set_title("Gaussians of the trained model; ± one standard deviation over seeds", loc="left", fontsize=10)
        axis.grid(color=LIGHT.faint, which="both", lw=0.7)
        axis.legend(frameon=False)
        figure.text(0.1, 0.95, title, fontsize=9)
        return svg_text(figure)


@study_command
def main(arguments: list[str]) -> int:
    parser = StudyParser(NAME, __doc__)
    parser.add_argument(
        "runs",
        type=Path,
        nargs="?",
        default=Path("results/runs/video_length"),
        metavar="RUNS",
        help="folder that holds the runs (default: %(default)s)",
    )
    options = parser.parse_args(arguments)
    collection = collect(options.runs)
    lengths = lengths_of(collection)
    for line in (*collection.left_out, *collection.warnings):
        print(f"warning: {line}", file=sys.stderr)
    run = collection.runs.iloc[0]
    made = f"{run['machine']}; {run['date'][:16]}; commit {run['git_commit'][:10]}; `{run['command']}`"
    table = markdown(
        lengths, f"{run['scene']}, {run['train']}, {run['ablation']}. {made} and the other runs of the sweep."
    )
    written = write_results(
        options.out,
        {
            f"{NAME}.csv": comma_separated(lengths),
            f"{NAME}.md": table,
            f"{NAME}.svg": draw(lengths, f"{run['scene']}, {run['machine']}, {run['date'][:10]}"),
        },
    )
    print(table)
    print(written)
    return 0


if __name__ == "__main__":
    sys.exit(main())
