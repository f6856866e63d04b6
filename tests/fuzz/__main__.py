"""`python -m fuzz [NAME …|all] [--seconds 60] [--seed 0]`: searches for inputs that violate a target's rule.

Without a name it lists the targets. Exit status 1 if a rule is violated; the input is saved, and the command that
replays it is printed.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path

from fuzz.subprocess_search import fuzz
from fuzz.target import load_changes, write_files
from fuzz.targets import NAMES, load_target


def main(arguments: list[str] | None = None) -> int:
    """The command; returns the exit status."""
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # idle threads of rasterize must not busy-wait
    parser = argparse.ArgumentParser(prog="python -m fuzz", description="Invalid inputs for readers and rasterizer.")
    parser.add_argument("names", nargs="*", metavar="NAME", help="targets; all: every one; none: list them")
    parser.add_argument("--seconds", type=float, default=60.0, help="for each target (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the cases (default: %(default)s)")
    parser.add_argument(
        "--keep",
        type=Path,
        default=Path("results/fuzz"),
        metavar="DIR",
        help="folder for inputs that violate a rule (default: %(default)s)",
    )
    parser.add_argument("--replay", type=Path, metavar="DIR", help="check one saved input, in this process")
    options = parser.parse_args(arguments)
    names = list(NAMES) if options.names == ["all"] else options.names
    if unknown := [name for name in names if name not in NAMES]:
        parser.error(f"no target {unknown[0]}; there are {', '.join(NAMES)}")
    if options.replay is not None:
        if len(names) != 1 or not options.replay.is_dir():
            parser.error("--replay takes one target and the folder of a saved input")
        print(f"{names[0]}: {replay(names[0], options.replay)}")
        return 0
    if not names:
        for name in NAMES:
            print(f"{name:<12} {load_target(name).about}")
        return 0
    violated = False
    for name in names:
        report = fuzz(load_target(name), options.seconds, options.seed, options.keep)
        print("\n".join(report.lines()), flush=True)
        violated |= report.error is not None
    return int(violated)


def replay(name: str, saved: Path) -> str:
    """Runs the target's check on a saved input; returns its outcome or raises its exception."""
    target = load_target(name)
    with tempfile.TemporaryDirectory(prefix="fuzz-") as temporary:
        folder = Path(temporary) / "case"
        write_files(folder, {**target.example(), **load_changes(saved)})
        return target.check(folder)


if __name__ == "__main__":
    sys.exit(main())
