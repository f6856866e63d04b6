"""Error against time: mean PSNR of several scenes after so many CPU seconds of training, by recipe and kernel.

Reads runs, finished or stopped, of the same scenes by each recipe. PSNR is -10 log10 of the MSE, so that its mean over
scenes is the mean logarithm of their errors. Writes error_against_time.md, .csv with every evaluation, and .svg.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from pipeline.runs.run_folder import csv_text
from pipeline.studies.common import StudyParser, markdown_table, write_results
from pipeline.studies.error_against_time.curves import Curve, by_recipe, mean_until_stopped, read_curves, value_at
from pipeline.studies.error_against_time.plot import draw
from pipeline.terminal.command_line import command

NAME = "error_against_time"
AT = (15, 30, 60, 120, 240, 480, 960, 1920)  # CPU seconds of the table


def markdown(groups: dict[str, list[Curve]]) -> str:
    """Mean PSNR at the times of AT; empty before all scenes have a value and where a run was stopped."""
    times = [at for at in AT if at <= max(curve.end for curves in groups.values() for curve in curves)]
    rows = []
    for name, curves in groups.items():
        mean = mean_until_stopped(curves)
        values = [value_at(*mean, at, last=all(curve.finished for curve in curves)) for at in times]
        end = f"{mean[1][-1]:.2f} after {sum(c.end for c in curves) / len(curves):.0f} s"
        rows.append([name, *("" if value is None else f"{value:.2f}" for value in values)])
        rows[-1].append(end if all(curve.finished for curve in curves) else "stopped")
    scenes = len({curve.scene for curves in groups.values() for curve in curves})
    return (
        f"### Mean PSNR of {scenes} scenes against CPU seconds of training\n\n"
        f"{markdown_table(['recipe', *(f'{at} s' for at in times), 'end'], rows)}\n"
    )


def comma_separated(groups: dict[str, list[Curve]]) -> str:
    header = ["commit", "kernel", "recipe", "scene", "seed", "finished"]
    header += ["iteration", "cpu_seconds", "psnr", "gaussians"]
    rows: list[Sequence[object]] = []
    for curve in (curve for curves in groups.values() for curve in curves):
        run = [curve.commit, curve.kernel, curve.recipe, curve.scene, curve.seed, int(curve.finished)]
        for iteration, seconds, psnr, gaussians in curve.evaluations.itertuples(index=False):
            rows.append([*run, int(iteration), f"{seconds:.2f}", f"{psnr:.3f}", int(gaussians)])
    return csv_text(header, rows)


@command
def main(arguments: list[str]) -> int:
    parser = StudyParser(NAME, __doc__)
    parser.add_argument("runs", type=Path, metavar="RUNS", help="folder of the runs")
    options = parser.parse_args(arguments)
    groups = by_recipe(read_curves(options.runs), options.runs)
    write_results(options.out, NAME, markdown(groups), {"csv": comma_separated(groups), "svg": draw(groups)})
    return 0


if __name__ == "__main__":
    sys.exit(main())
