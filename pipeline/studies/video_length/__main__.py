"""Video length: Gaussians of trained models against the number of frames.

Reads runs that differ in scene.frames and seed only (python -m pipeline experiment=video_length trains them). The size
of a model grows with its Gaussians, the cost of a frame with those that are active in the frame. Exponents e are of
N = c · frames^e. Writes video_length.md and .csv.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from pipeline.presentation.statistics import estimate
from pipeline.presentation.table import measured
from pipeline.runs.run_folder import csv_text
from pipeline.runs.run_identity import FREE_KEYS, flat, read_config
from pipeline.studies.common import StudyParser, markdown_table, write_results
from pipeline.terminal.command_line import command

NAME = "video_length"
COLUMNS = {"gaussians": "Gaussians", "alive": "active in a frame", "psnr": "PSNR, dB", "seconds": "train s"}
_LINES = ("gaussians", "alive")
_KEY = "scene.frames"

Lengths = dict[int, dict[str, np.ndarray]]  # frames, ascending → the values of COLUMNS over the seeds; NaN: missing


def read_lengths(folder: Path) -> Lengths:
    """ValueError, one line, where the runs differ in more than frames and seed, or do not in frames."""
    runs = {path.parent: json.loads(path.read_text()) for path in sorted(folder.rglob("metrics.json"))}
    if not runs:
        raise ValueError(f"{folder}: expected folders of finished runs, found none")
    settings = {run: flat(read_config(run / "config.yaml")) for run in runs}
    first, frames = next(iter(runs)), {}
    for run, keys in settings.items():
        name = run.relative_to(folder)
        if not isinstance(count := keys.get(_KEY), int):
            raise ValueError(f"{name}: expected a config.yaml with {_KEY}, found none")
        frames[run] = count
        for key in sorted(keys.keys() | settings[first].keys()):
            free = key in (_KEY, "seed") or key.startswith(FREE_KEYS)
            if not free and keys.get(key) != settings[first].get(key):
                raise ValueError(
                    f"{name}: expected the settings of {first.relative_to(folder)} except {_KEY} and seed, found "
                    f"another {key}"
                )
    if len(set(frames.values())) < 2:
        raise ValueError(f"{_KEY}: expected runs of at least two lengths, found only {frames[first]}")
    found: Lengths = {}
    for count in sorted(set(frames.values())):
        values = [
            (m["n_gaussians"], m.get("n_alive_mean"), m["final"]["psnr"], m["train_seconds"])
            for run, m in runs.items()
            if frames[run] == count
        ]
        found[count] = dict(zip(COLUMNS, np.array(values, dtype=float).T))
    return found


def exponent(lengths: Lengths, column: str) -> float:
    """e of `column` = c · frames^e, by least squares of the logarithms; NaN where a length lacks the value."""
    means = [values[column].mean() for values in lengths.values()]
    return float(np.polyfit(np.log(list(lengths)), np.log(means), 1)[0])


def markdown(lengths: Lengths, heading: str) -> str:
    rows = [
        [
            f"{frames:,}",
            *(measured(estimate(v[column]), 2 if column == "psnr" else 0).text for column in COLUMNS),
            f"{v['alive'].mean() / v['gaussians'].mean():.2f}",
        ]
        for frames, v in lengths.items()
    ]
    exponents = "; ".join(f"{COLUMNS[line]} {exponent(lengths, line):z.2f}" for line in _LINES)
    return (
        f"### Gaussians against the length of a video\n\n{heading}\n\n"
        f"{markdown_table(['frames', *COLUMNS.values(), 'active fraction'], rows)}\n\n"
        f"- Exponents e of N = c · frames^e: {exponents}. ±: half the 95 % t-interval over seeds; no ±: one seed.\n"
    )


def comma_separated(lengths: Lengths) -> str:
    rows = [[frames, *run] for frames, values in lengths.items() for run in zip(*(values[c].tolist() for c in COLUMNS))]
    return csv_text(["frames", *COLUMNS], rows)


@command
def main(arguments: list[str]) -> int:
    parser = StudyParser(NAME, __doc__)
    default = Path("results/runs") / NAME
    parser.add_argument(
        "runs", type=Path, nargs="?", default=default, metavar="RUNS", help=f"folder of the runs (default: {default})"
    )
    options = parser.parse_args(arguments)
    lengths = read_lengths(options.runs)
    scene = json.loads(next(options.runs.rglob("metrics.json")).read_text())["scene"]
    made = json.loads(next(options.runs.rglob("environment.json")).read_text())
    machine, date, commit = made["machine"], made["date"], made["git_commit"][:10]
    table = markdown(lengths, f"{scene}. {machine}; {date[:16]}; commit {commit}; `{made['command']}` and its sweep.")
    write_results(options.out, NAME, table, {"csv": comma_separated(lengths)})
    return 0


if __name__ == "__main__":
    sys.exit(main())
