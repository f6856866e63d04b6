"""What pyproject.toml says, and what the Python files import: for the tests of set-up, lock and library."""

from __future__ import annotations

import ast
import tomllib
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def declared() -> dict[str, list[Requirement]]:
    """What pyproject.toml asks for: `build` its tools, `library` the dependencies, and each extra under its name."""
    project = PYPROJECT["project"]
    groups = {
        "build": PYPROJECT["build-system"]["requires"],
        "library": project["dependencies"],
        **project["optional-dependencies"],
    }
    return {group: [Requirement(line) for line in lines] for group, lines in groups.items()}


def imported_modules(file: Path) -> set[str]:
    """Top-level names of what a Python file imports, at the top or later; relative imports left out."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.add(node.module.split(".")[0])
    return found
