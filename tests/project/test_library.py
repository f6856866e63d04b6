"""Only the rasterizer is a library: what its wheel holds and needs, its version and licence."""

from __future__ import annotations

import re
import sys
from importlib.metadata import metadata, packages_distributions

import pytest
import yaml
from project_file import PYPROJECT, ROOT, declared, imported_modules

from rasterizer.bench import __main__ as bench


def test_every_imported_package_is_declared():
    names = {needed.name.lower() for group in declared().values() for needed in group}
    names |= {"omegaconf", "gaussians-4d"}  # a part of hydra-core's interface; this project itself
    packages_of = packages_distributions()
    for folder in ("rasterizer", "datasets", "pipeline", "tests"):
        for file in (ROOT / folder).rglob("*.py"):
            modules = imported_modules(file)
            packages = {name.lower() for module in modules for name in packages_of.get(module, [])}
            assert packages <= names, file.relative_to(ROOT)


def test_only_the_rasterizer_is_in_the_wheel_and_the_checkout_holds_all():
    settings = PYPROJECT["tool"]["scikit-build"]
    assert settings["wheel"]["packages"] == ["rasterizer", "gaussians_4d"]
    assert "build-dir" not in settings  # a wheel's build would change the one that `make` keeps
    (override,) = settings["overrides"]
    assert override["wheel"]["packages"] == ["rasterizer", "datasets", "pipeline", "gaussians_4d"]
    for state, taken in (("editable", True), ("metadata_editable", True), ("wheel", False), ("sdist", False)):
        assert bool(re.search(override["if"]["state"], state)) is taken


def test_the_library_needs_only_what_it_declares():
    packages_of = packages_distributions()
    for file in (ROOT / "rasterizer").rglob("*.py"):
        extra = "bench" if file.parent.name == "bench" else "gpu" if file.name.startswith("gsplat") else None
        groups = {"library", extra} - {None}
        may = {needed.name for name in groups for needed in declared()[name]} | {"gaussians-4d"}
        modules = imported_modules(file)
        assert not modules & {"pipeline", "datasets", "fuzz", "tests"}, file
        assert {name.lower() for module in modules for name in packages_of.get(module, [])} <= may, file
    assert {needed.name for needed in declared()["library"]} == {"torch", "numpy"}


def test_version_and_licence_are_those_of_pyproject():
    project = PYPROJECT["project"]
    assert metadata("gaussians-4d")["Version"] == project["version"]
    assert metadata("gaussians-4d")["License-Expression"] == project["license"] == "Apache-2.0"
    assert "Apache License" in (ROOT / "LICENSE").read_text()
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert (citation["version"], citation["license"]) == (project["version"], project["license"])


def test_a_plot_without_matplotlib_is_refused_in_one_line_before_measuring(monkeypatch):
    monkeypatch.setattr(bench.importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(bench, "measure_rates", lambda: pytest.fail("measured first"))
    for wish in (["--all"], ["--plot", "roofline.png"]):
        monkeypatch.setattr(sys, "argv", ["bench", "W1", *wish])
        with pytest.raises(SystemExit, match="^error: .*matplotlib.*pip install matplotlib$"):
            bench.main()
