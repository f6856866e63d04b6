"""Manifests: what the files of a data set are, by name, bytes and SHA-256; manifests/*.yaml has one file for each.

A scene's SHA-256 is that of the lines `sha256sum` prints of its files, sorted by name:

    cd SCENE && LC_ALL=C sha256sum FILE… | sha256sum

The first 8 digits of each file's own say which one is altered. A synthetic scene has a manifest in its folder.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from datasets.files.atomic_write import write_text
from datasets.files.errors import DataError, SceneError

FOLDER = Path(__file__).with_name("manifests")
OWN = "manifest.yaml"  # in the folder of a synthetic scene
AS_PUBLISHED = "as published"
DIGITS = 8  # of a file's SHA-256


@dataclass(frozen=True)
class File:
    bytes: int
    digits: str  # the first of its SHA-256


@dataclass(frozen=True)
class SceneFiles:
    sha256: str
    files: dict[str, File]  # by path below the scene's folder

    @property
    def bytes(self) -> int:
        return sum(file.bytes for file in self.files.values())


@dataclass(frozen=True)
class Manifest:
    """One data set."""

    name: str
    title: str
    source: str
    licence: str
    scenes: dict[str, SceneFiles]
    faults: tuple[str, ...] = ()


@dataclass(frozen=True)
class Found:
    """A scene's folder beside its manifest."""

    sha256: str  # of the files that are there
    missing: tuple[str, ...]
    altered: tuple[str, ...]  # `train/r_0.png (expected 12 bytes, found 10)`
    strange: int  # files that are not in the manifest, which matter to no reader

    def __str__(self) -> str:
        """Empty where all is as published."""
        parts = (("missing", self.missing), ("altered", self.altered))
        return "; ".join(f"{len(names)} {word}: {_some(names)}" for word, names in parts if names)


def names() -> list[str]:
    return sorted(path.stem for path in FOLDER.glob("*.yaml"))


def published(name: str) -> Manifest:
    """The manifest `dnerf`. SceneError for a name without one."""
    if name not in names():
        raise SceneError("manifest", f"one of {', '.join(names())}, or synthetic/NAME", repr(name))
    return read_manifest(FOLDER / f"{name}.yaml")


def read_manifest(path: Path) -> Manifest:
    """DataError, one line, for another content."""
    try:
        tree: Any = yaml.safe_load(path.read_text(encoding="utf-8"))
        scenes = {
            name: SceneFiles(str(scene["sha256"]), dict(map(_file_of, scene["files"].splitlines())))
            for name, scene in tree.pop("scenes").items()
        }
        return Manifest(**{"name": path.stem, **tree, "scenes": scenes, "faults": tuple(tree.get("faults", ()))})
    except (yaml.YAMLError, KeyError, TypeError, ValueError, AttributeError, OSError) as error:
        raise DataError(path, "a manifest", str(error)) from None


def described(folder: Path, files: list[str]) -> SceneFiles:
    """Of these files below `folder`."""
    digests = {name: _sha256(folder / name) for name in sorted(files)}
    return SceneFiles(
        _of_lines(digests), {n: File((folder / n).stat().st_size, d[:DIGITS]) for n, d in digests.items()}
    )


def write_manifest(path: Path, manifest: Manifest) -> None:
    head: dict[str, Any] = {
        "name": manifest.name,
        "title": manifest.title,
        "source": manifest.source,
        "licence": manifest.licence,
    }
    head |= {"faults": list(manifest.faults)} if manifest.faults else {}
    lines = [yaml.safe_dump(head, sort_keys=False, allow_unicode=True, width=10_000) + "scenes:"]
    for name, scene in manifest.scenes.items():
        total = f"{len(scene.files)} files, {scene.bytes} bytes"
        lines += [f"  {name}:  # {total}", f"    sha256: {scene.sha256}", "    files: |"]
        lines += [f"      {file.digits} {file.bytes} {path}" for path, file in scene.files.items()]
    write_text(path, "\n".join(lines) + "\n")


def compared(scene: SceneFiles, folder: Path) -> Found:
    """The files below `folder` with those of the manifest."""
    digests = {name: _sha256(folder / name) for name in sorted(scene.files) if (folder / name).is_file()}
    altered = tuple(
        f"{name} ({scene.files[name].bytes} bytes expected, {(folder / name).stat().st_size} found)"
        for name, digest in digests.items()
        if digest[:DIGITS] != scene.files[name].digits
    )
    strange = sum(1 for path in folder.rglob("*") if path.is_file() and path.name != OWN) - len(digests)
    found = Found(_of_lines(digests), tuple(n for n in scene.files if n not in digests), altered, strange)
    if not str(found) and found.sha256 != scene.sha256:
        raise DataError(folder, f"SHA-256 {scene.sha256[:12]}… of its files", f"{found.sha256[:12]}…")
    return found


def manifest_of(name: str, folder: Path) -> tuple[str, SceneFiles] | None:
    """The name and the files of a scene `dnerf/hook` that is read from `folder`; None where none are published."""
    if (folder / OWN).is_file():
        own = read_manifest(folder / OWN)
        return own.name, next(iter(own.scenes.values()))
    data_set, _, scene = name.partition("/")
    if data_set not in names() or scene not in (known := published(data_set).scenes) or not folder.is_dir():
        return None
    return name, known[scene]


def recorded(name: str, folder: Path) -> dict[str, str] | None:
    """What a run keeps of its data: manifest, SHA-256 of the files, how they differ; None: none is published."""
    if (known := manifest_of(name, folder)) is None:
        return None
    found = compared(known[1], folder)
    return {"manifest": known[0], "sha256": found.sha256, "found": str(found) or AS_PUBLISHED}


def _of_lines(digests: dict[str, str]) -> str:
    return hashlib.sha256("".join(f"{digest}  {name}\n" for name, digest in digests.items()).encode()).hexdigest()


def _file_of(line: str) -> tuple[str, File]:
    digits, size, name = line.split(" ", 2)
    return name, File(int(size), digits)


def _sha256(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _some(names: tuple[str, ...]) -> str:
    return ", ".join(names[:5]) + (" …" if len(names) > 5 else "")
