"""How many Gaussians a longer video takes, from trained models: python -m pipeline.studies.video_length

Reads runs that differ in how many frames were filmed (python -m pipeline experiment=video_length makes them) and sets
N, and the Gaussians alive in a frame, against the number of frames, as a figure of the paper's appendix does. What a
frame costs follows the second, what the model weighs the first. Table and plot; exponents e of N = c · frames^e.
"""

from __future__ import annotations

import argparse
import csv
import io
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from pipeline.presentation.seeds import Estimate, estimate
from pipeline.presentation.table import measured
from pipeline.presentation.theme import LIGHT
from pipeline.runs.read.collect import Collection, collect
from pipeline.runs.read.variants import schedule_settings
from pipeline.terminal.closed_pipe import quiet_on_closed_pipe

_KEY = "scene.frames"
_LINES = (("gaussians", "Gaussians"), ("alive", "alive in a frame"))


@dataclass(frozen=True)
class Length:
    """The seeds of one length. An estimate is None where a run lacks the number."""

    frames: int
    gaussians: Estimate | None
    alive: Estimate | None  # p(t) >= 0.05, mean over the test views
    psnr: Estimate | None  # dB, final
    seconds: Estimate | None  # of training


def lengths_of(collection: Collection) -> list[Length]:
    """Shortest first. ValueError, one line, unless the runs differ in their frames and their seed, and in no more."""
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
                f"{run}: expected the settings of {first} but for {_KEY} and seed, found another {min(differing)}"
            )
    frames = collection.runs["run"].map(lambda run: int(settings[run][_KEY]))
    found = [_length(count, runs) for count, runs in collection.runs.groupby(frames, sort=True)]
    if len(found) < 2:
        raise ValueError(f"{_KEY}: expected runs of two lengths at least, found {found[0].frames} alone")
    return found


def _length(frames: int, runs: pd.DataFrame) -> Length:
    return Length(
        int(frames),
        estimate(runs["n_gaussians"]),
        estimate(runs["n_alive_mean"]),
        estimate(runs["final.psnr"]),
        estimate(runs["train_seconds"]),
    )


def exponent(lengths: Sequence[Length], line: str) -> float:
    """e of `line` = c · frames^e, least squares of the logarithms; NaN where a length lacks the number."""
    means = [np.nan if (value := getattr(length, line)) is None else value.mean for length in lengths]
    return float(np.polyfit(np.log([length.frames for length in lengths]), np.log(means), 1)[0])


def comma_separated(lengths: Sequence[Length]) -> str:
    """A line a length: means, and std over seeds where there are several."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    columns = ("gaussians", "alive", "psnr", "seconds")
    writer.writerow(["frames", "seeds", *(name for column in columns for name in (column, f"{column}_std"))])
    for length in lengths:
        cells = []
        for value in (getattr(length, column) for column in columns):
            cells += ["", ""] if value is None else [value.mean, "" if np.isnan(value.std) else value.std]
        writer.writerow([length.frames, length.gaussians.n, *cells])
    return buffer.getvalue()


def markdown(lengths: Sequence[Length], heading: str) -> str:
    lines = [
        "### Gaussians against the length of a video",
        "",
        heading,
        "",
        "| frames | Gaussians | alive in a frame | part alive | PSNR, dB | train s |",
        "|---:|---:|---:|---:|---:|---:|",
    ]
    for length in lengths:
        part = f"{length.alive.mean / length.gaussians.mean:.2f}" if length.alive else "n/a"
        lines.append(
            f"| {length.frames:,} | {measured(length.gaussians, 0).text} | {measured(length.alive, 0).text} | "
            f"{part} | {measured(length.psnr).text} | {measured(length.seconds, 0).text} |"
        )
    grown = "; ".join(f"{label} {exponent(lengths, line):z.2f}" for line, label in _LINES)
    note = f"- Exponents e of N = c · frames^e: {grown}. ±: standard deviation over seeds; no ±: one seed."
    return "\n".join([*lines, "", note]) + "\n"


def draw(lengths: Sequence[Length], title: str) -> str:
    """SVG text, both axes logarithmic; the same numbers give the same bytes."""
    with matplotlib.rc_context({"svg.hashsalt": "video-length", "font.family": "DejaVu Sans", "font.size": 9.5}):
        figure = Figure(figsize=(7.2, 4.4), facecolor="white")
        FigureCanvasSVG(figure)
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
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


@quiet_on_closed_pipe()
def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m pipeline.studies.video_length", description=__doc__.splitlines()[0]
    )
    parser.add_argument(
        "runs",
        type=Path,
        nargs="?",
        default=Path("results/runs/video_length"),
        metavar="RUNS",
        help="folder of runs (results/runs/video_length)",
    )
    parser.add_argument("--out", type=Path, default=Path("results/scaling"), help="(results/scaling)")
    options = parser.parse_args(arguments)
    try:
        collection = collect(options.runs)
        lengths = lengths_of(collection)
    except (FileNotFoundError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    for line in (*collection.left_out, *collection.warnings):
        print(f"warning: {line}", file=sys.stderr)
    run = collection.runs.iloc[0]
    made = f"{run['machine']}; {run['date'][:16]}; commit {run['git_commit'][:10]}; `{run['command']}`"
    heading = f"{run['scene']}, {run['train']}, {run['ablation']}. {made} and its sisters."
    options.out.mkdir(parents=True, exist_ok=True)
    for suffix, content in (
        ("csv", comma_separated(lengths)),
        ("md", markdown(lengths, heading)),
        ("svg", draw(lengths, f"{run['scene']}, {run['machine']}, {run['date'][:10]}")),
    ):
        (options.out / f"video_length.{suffix}").write_text(content, encoding="utf-8")
    print(markdown(lengths, heading))
    print(f"written to {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
