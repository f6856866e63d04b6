"""The files that other files name: names may differ in Unicode's form (macOS), in case or in slashes (Windows)."""

from __future__ import annotations

import os
import unicodedata
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

from datasets.files.errors import SceneError
from datasets.files.image_files import is_file


def named_path(root: Path, name: str) -> Path:
    """The path of the file that is called `name`, relative to `root`; where there is none, of one that would be.

    In this order: the name as it is, with slashes for Windows' backslashes, and the one file whose name differs in form
    or case only. SceneError for several.
    """
    exact = root / name
    if is_file(exact):
        return exact
    slashes = root / name.replace("\\", "/")
    return slashes if is_file(slashes) else _alike(slashes) or slashes


def say_renamed(where: Path, stated: Iterable[Path], found: Iterable[Path], log: Callable[[str], None]) -> None:
    """A line on the files that `named_path` found under another name than the file `where` states."""
    others = [(a, b) for a, b in zip(stated, found) if not str(b).startswith(str(a).replace("\\", "/"))]
    if others:
        (a, b), count = others[0], len(others)
        log(f"{where.name}: {count} names differ from the files' in Unicode's form or case only, {a.name} is {b.name}")


def _alike(path: Path) -> Path | None:
    """The file whose path differs from `path` in form or case only; None without one."""
    found = Path(path.anchor)
    for part in path.parts[1:] if path.anchor else path.parts:
        if os.path.exists(found / part):
            found /= part
            continue
        names = _listing(found, os.stat(found).st_mtime_ns).get(_folded(part), []) if os.path.isdir(found) else []
        if len(names) > 1:
            both = f"{' and '.join(sorted(names)[:2])}, which differ in Unicode's form or case only"
            raise SceneError(path, f"one file of this name in {found}", both)
        if not names:
            return None
        found /= names[0]
    return found if is_file(found) else None


@lru_cache(maxsize=64)
def _listing(folder: Path, changed: int) -> dict[str, list[str]]:
    names: dict[str, list[str]] = {}
    with suppress(OSError):  # a folder without permission
        for name in os.listdir(folder):
            names.setdefault(_folded(name), []).append(name)
    return names


def _folded(name: str) -> str:
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())
