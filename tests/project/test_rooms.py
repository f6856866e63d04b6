"""Imports point one way: from entry points down to the configuration, and in no circle."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from project_file import ROOT

# Room -> its floor. A file imports from its own room and from floors below; rooms on one floor do not know each other.
FLOORS = {
    "pipeline.studies": 13,  # leaves: nothing imports a study
    "pipeline": 12,  # the entry points: __main__, cli, evaluate, render
    "pipeline.stages": 11,
    "pipeline.export": 10,
    "pipeline.figures": 10,
    "pipeline.view": 10,
    "pipeline.trained": 9,
    "pipeline.report": 9,
    "pipeline.training": 8,
    "pipeline.evaluation": 7,
    "pipeline.model": 6,
    "pipeline.data": 5,
    "pipeline.presentation": 4,
    "pipeline.runs": 3,
    "pipeline.terminal": 3,
    "pipeline.config": 2,
    "datasets": 1,
    "rasterizer": 0,
}
REPORT = {"": 4, "write": 3, "tables": 2, "compare": 1, "read": 0}  # the report's own floors
MOST_FILES = 15  # of a folder's own


def modules() -> dict[str, Path]:
    files = (file for folder in ("pipeline", "datasets", "rasterizer") for file in (ROOT / folder).rglob("*.py"))
    return {".".join(f.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): f for f in files}


MODULES = modules()


def imports(name: str) -> set[str]:
    """The project's modules that a module imports, wherever in it."""
    found = set()
    for node in ast.walk(ast.parse(MODULES[name].read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: a relative import"
            whole = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {module if module in MODULES else node.module for module in whole}
    return (found & MODULES.keys()) - {name}


def room(module: str) -> str:
    parts = module.split(".")
    two = ".".join(parts[:2])
    return two if two in FLOORS else parts[0]


@pytest.mark.parametrize("name", sorted(MODULES))
def test_imports_point_down(name: str) -> None:
    for other in imports(name):
        if room(other) != room(name):
            assert FLOORS[room(other)] < FLOORS[room(name)], f"{name} imports {other}"
        elif room(name) == "pipeline.report":
            mine, theirs = (m.removeprefix("pipeline.report.").split(".")[0] for m in (name, other))
            assert REPORT.get(theirs, 4) <= REPORT.get(mine, 4), f"{name} imports {other}"


def test_there_is_no_circle() -> None:
    done: set[str] = set()

    def visit(name: str, path: tuple[str, ...]) -> None:
        assert name not in path, " -> ".join((*path[path.index(name) :], name))
        if name not in done:
            for other in sorted(imports(name)):
                visit(other, (*path, name))
            done.add(name)

    for name in sorted(MODULES):
        visit(name, ())


def test_no_folder_is_crowded() -> None:
    folders = {
        f.parent
        for folder in ("pipeline", "datasets", "rasterizer", "tests", "tools", "conf")
        for f in (ROOT / folder).rglob("*")
        if f.suffix in (".py", ".hpp", ".cpp", ".yaml")
    }
    for folder in folders:
        files = [f.name for f in folder.iterdir() if f.suffix in (".py", ".hpp", ".cpp", ".yaml")]
        assert len(files) <= MOST_FILES, f"{folder.relative_to(ROOT)}: {len(files)} files"
