"""gaussians-4d scene=synthetic/wheel, gaussians-4d render RUN: the commands of `pipeline`, from any folder.

`python -m pipeline` runs a pipeline.py that lies in the current folder; this does not. `python -m gaussians_4d` is the
same where it is not installed.
"""

from __future__ import annotations

import os
import runpy
import sys

COMMANDS = ("evaluate", "export", "figures", "pack", "render", "report", "score", "validate", "view")


def main() -> None:
    root = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    if not os.path.isfile(os.path.join(root, "pipeline", "cli.py")):
        sys.exit("error: gaussians-4d: expected a checkout, whose commands these are, found the rasterizer alone")
    sys.path.insert(0, root)
    name = f"pipeline.{sys.argv.pop(1)}" if sys.argv[1:2] and sys.argv[1] in COMMANDS else "pipeline"
    runpy.run_module(name, run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
