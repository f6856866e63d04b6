"""Stores new figures of the kernel beside their studies, if they are all of today's kernel; `make numerics`.

Copies what `make stability work-precision bench` wrote below results/. --check: says instead which stored figures are
of another kernel than today's. Exit status 1 where a figure is of another kernel, or missing.
"""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

from pipeline.terminal.command_line import CommandParser, command
from rasterizer.kernel_loader import source_hash

ROOT = Path(__file__).resolve().parents[2]
# What the commands write -> where it is stored. The first of each has the kernel's hash.
STORED = {
    "results/kernel_stability": {
        "kernel_stability.md": "pipeline/studies/kernel_stability/results.md",
        "kernel_stability.csv": "pipeline/studies/kernel_stability/results.csv",
    },
    "results/kernel_precision": {
        "kernel_precision.md": "pipeline/studies/kernel_precision/results.md",
        "kernel_precision.csv": "pipeline/studies/kernel_precision/results.csv",
        "kernel_precision.svg": "pipeline/studies/kernel_precision/kernel_precision.svg",
    },
    "results/bench": {
        "bench.txt": "results/measured/bench/bench.txt",
        "roofline.png": "results/measured/bench/roofline.png",
    },
}


@command
def main(arguments: list[str]) -> int:
    parser = CommandParser("studies.stored", __doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="only say which stored figures are of another kernel")
    options = parser.parse_args(arguments)
    return store(ROOT, source_hash(), check=options.check)


def store(root: Path, kernel: str, check: bool = False) -> int:
    """Copies nothing unless all are of this kernel. Returns the exit status."""
    heads = [
        root / (next(iter(files.values())) if check else f"{folder}/{next(iter(files))}")
        for folder, files in STORED.items()
    ]
    wrong = [(head, found) for head in heads if (found := kernel_of(head)) != kernel]
    for head, found in wrong:
        print(f"{head.relative_to(root)}: expected figures of kernel {kernel}, found {found}", file=sys.stderr)
    if not wrong and not check:
        for folder, files in STORED.items():
            for name, place in files.items():
                shutil.copyfile(root / folder / name, root / place)
        print(f"stored figures of kernel {kernel}: {', '.join(STORED)}")
    return 1 if wrong else 0


def kernel_of(file: Path) -> str:
    """The hash that the file states, or what is wrong with it."""
    if not file.is_file():
        return "no file"
    found = re.search(r"\bkernel ([0-9a-f]{12})\b", file.read_text(encoding="utf-8"))
    return found.group(1) if found else "none stated"


if __name__ == "__main__":
    sys.exit(main())
