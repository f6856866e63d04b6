"""The fuzz targets, one module each, which defines TARGET. A target's name is the name of its module."""

from __future__ import annotations

import importlib
import pkgutil

from fuzz.target import Target

NAMES = tuple(sorted(module.name for module in pkgutil.iter_modules(__path__)))


def load_target(name: str) -> Target:
    """The target of a name; imports only its module, because each needs its own packages."""
    return importlib.import_module(f"fuzz.targets.{name}").TARGET
