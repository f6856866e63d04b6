"""`python -m fuzz [NAME …|all] [--seconds 60] [--seed 0]`: searches for inputs that break a target's rule.

Without a name it lists the targets. Exit status 1 if something was found; the input is kept, and the line that
replays it printed.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path

from fuzz.supervise import fuzz
from fuzz.target import kept_changes, write_files
from fuzz.targets import MODULES, target_of


def main(arguments: list[str] | None = None) -> int:
    """The command; returns the exit status."""
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # of the searches: more threads than free processors are usual
    parser = argparse.ArgumentParser(prog="python -m fuzz", description="Odd inputs for readers and rasterizer.")
    parser.add_argument("names", nargs="*", metavar="NAME", help="targets; all: every one; none: list them")
    parser.add_argument("--seconds", type=float, default=60.0, help="for each target (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="other cases for another (default: %(default)s)")
    parser.add_argument(
        "--keep",
        type=Path,
        default=Path("results/fuzz"),
        metavar="DIR",
        help="where inputs that break a rule are kept (default: %(default)s)",
    )
    parser.add_argument("--replay", type=Path, metavar="DIR", help="check one kept input, in this process")
    options = parser.parse_args(arguments)
    names = list(MODULES) if options.names == ["all"] else options.names
    if unknown := [name for name in names if name not in MODULES]:
        parser.error(f"no target {unknown[0]}; there are {', '.join(MODULES)}")
    if options.replay is not None:
        if len(names) != 1 or not options.replay.is_dir():
            parser.error("--replay takes one target and a folder that it kept")
        print(f"{names[0]}: {replay(names[0], options.replay)}")
        return 0
    if not names:
        for name in MODULES:
            print(f"{name:<12} {target_of(name).about}")
        return 0
    found = False
    for name in names:
        report = fuzz(target_of(name), options.seconds, options.seed, options.keep)
        print("\n".join(report.lines()), flush=True)
        found |= report.fault is not None
    return int(found)


def replay(name: str, kept: Path) -> str:
    """What the target's check says of a kept input; raises as it does."""
    target = target_of(name)
    with tempfile.TemporaryDirectory(prefix="fuzz-") as temporary:
        folder = Path(temporary) / "case"
        write_files(folder, {**target.example(), **kept_changes(kept)})
        return target.check(folder)


if __name__ == "__main__":
    sys.exit(main())
