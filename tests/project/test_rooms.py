"""Imports point one way: from entry points down to the configuration, and in no circle."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

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
    "pipeline.terminal": 4,
    "pipeline.runs": 3,
    "pipeline.config": 2,
    "datasets": 1,
    "rasterizer": 0,
}


def modules() -> dict[str, Path]:
    files = (file for folder in ("pipeline", "datasets", "rasterizer") for file in (ROOT / folder).rglob("*.py"))
    return {".".join(f.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): f for f in files}


MODULES = modules()


@cache
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


def points_down(name: str, other: str) -> bool:
    return room(other) == room(name) or FLOORS[room(other)] < FLOORS[room(name)]


def test_imports_point_down() -> None:
    assert [(name, other) for name in sorted(MODULES) for other in imports(name) if not points_down(name, other)] == []


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


def test_the_rooms_of_the_tests_are_those_of_the_code() -> None:
    tests = ROOT / "tests"
    rooms = {file.parent.relative_to(tests) for file in tests.rglob("test_*.py")}
    others = {"cluster", "fuzz", "project", "real_data"}
    assert [room for room in sorted(rooms) if room.parts[0] not in others and not (ROOT / room).is_dir()] == []
