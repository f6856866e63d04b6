"""The fuzz targets, one module each, which defines TARGET. A target's name is the name of its module."""

from __future__ import annotations

import importlib
import pkgutil

from fuzz.target import Target

_MODULES = {
    module.name.rpartition(".")[2]: module.name
    for module in pkgutil.walk_packages(__path__, f"{__name__}.")
    if not module.ispkg
}
NAMES = tuple(sorted(_MODULES))


def load_target(name: str) -> Target:
    """The target of a name; imports only its module, because each needs its own packages."""
    return importlib.import_module(_MODULES[name]).TARGET
