"""Splat files of a trained model, for other programs.

MODEL is a run folder, or a file: a checkpoint (.safetensors), a model (.ply) or a checkpoint of the released program
(.pth). A static format holds one frame: without --times there are 30, from the first time to the last, as a sequence
that SuperSplat plays. --times are seconds since the start of a run (of photographs 0 to 1), of a file its own times.
Lengths and times in the files are canonical (docs/conventions.md); --world gives those of the data's files.
"""

from __future__ import annotations

import argparse
import math
import sys
import textwrap
from pathlib import Path

import numpy as np
import torch

from pipeline.export.formats import FILM, FORMATS, MODEL, write_files
from pipeline.export.source import Source, open_source
from pipeline.terminal.command_line import CommandParser, command, log

SEQUENCE = 30  # frames


@command
def main(arguments: list[str]) -> int:
    parser = _parser()
    options = parser.parse_args(arguments)
    if (duration := options.duration) is not None:
        parser.require(0 < duration < math.inf, "--duration", "a positive time", f"{duration:g}")
    if (start := options.start) is not None:
        parser.require(math.isfinite(start), "--start", "a finite time", f"{start:g}")
    frames = any(FORMATS[name].holds not in (MODEL, FILM) for name in options.formats)
    parser.require(frames or not options.times, "--times", "a format of one moment", ", ".join(options.formats))
    torch.set_num_threads(1)  # many small products, which more threads make slower
    source = open_source(options.model, options.start, options.duration, log)
    folder = options.out or source.folder
    for name in options.formats:
        paths = list(write_files(name, source, _times(options.times, source), folder, options.world, log))
        size = sum(path.stat().st_size for path in paths)
        files = f"{paths[0].name} … {paths[-1].name}" if len(paths) > 1 else paths[0].name
        lost = FORMATS[name].loses
        if source.model.environment_map is not None and FORMATS[name].holds != MODEL:
            lost += "; the environment map"
        log(f"{folder}/{files}: {size / 1e6:.1f} MB; lost: {lost}")
    return 0


def _times(wanted: list[float] | None, source: Source) -> list[float]:
    """Of the frames of a static format. ValueError for one outside of the scene's time."""
    line = source.timeline
    if source.model.kind.motion == "static":
        return [line.start]
    if wanted is None:
        return np.linspace(line.start, line.end, SEQUENCE).tolist()
    return [line.at(time) for time in wanted]


def _parser() -> CommandParser:
    parser = CommandParser("export", __doc__, epilog=_table())
    parser.add_argument("model", type=Path, metavar="MODEL", help="a run folder, or a file of a model")
    parser.add_argument("formats", nargs="+", choices=FORMATS, metavar="FORMAT", help=", ".join(FORMATS))
    parser.add_argument(
        "--times",
        type=_numbers,
        metavar="T,T,…",
        help=f"of the frames of a static format (default: {SEQUENCE} from the first time to the last)",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="default: exports/ in the run folder or beside the file"
    )
    parser.add_argument("--world", action="store_true", help="lengths and times of the data's files, not canonical")
    parser.add_argument("--start", type=float, metavar="T", help="of a file: the scene's first time (default: 0)")
    parser.add_argument("--duration", type=float, metavar="T", help="of a file: the scene's duration (default: 1)")
    return parser


def _numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected times such as 0,0.5,1, found {text}") from None


def _table() -> str:
    lines = ["formats, who reads them, and what they lose:", ""]
    for name, form in FORMATS.items():
        lines.append(f"  {name:<9} {form.holds}; {form.read_by}")
        lines += textwrap.wrap(f"loses {form.loses}", 110, initial_indent=" " * 12, subsequent_indent=" " * 12)
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
