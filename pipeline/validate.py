"""Whether run folders follow their JSON Schema, pipeline/runs/schemas/: a line for each place that does not.

Exit status 1 where there is one. A folder of images that were given (`python -m pipeline.score`) follows it too.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from jsonschema import Draft202012Validator

from pipeline.runs.folder_content import folder_content, schema
from pipeline.terminal.command_line import CommandParser, command, log


def violations(name: str, content: Any) -> list[str]:
    """Of the schema `metrics` or `run_folder`, each `$.metrics.json.seed: -1 is less than the minimum of 0`."""
    validator = Draft202012Validator(schema(name), format_checker=Draft202012Validator.FORMAT_CHECKER)
    return [f"{error.json_path}: {error.message}" for error in validator.iter_errors(content)]


@command
def main(arguments: list[str]) -> int:
    parser = CommandParser("validate", __doc__)
    parser.add_argument("runs", type=Path, nargs="+", metavar="RUN", help="folder of a finished run")
    wrong = 0
    for run in parser.parse_args(arguments).runs:
        found = violations("run_folder", folder_content(run))
        wrong += bool(found)
        for line in found or ["follows the schema"]:
            log(f"{run}: {line}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
