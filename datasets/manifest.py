"""Manifests: what the files of a data set are, by name, bytes and SHA-256; manifests/*.yaml has one file for each.

A scene's SHA-256 is that of the lines `sha256sum` prints of its files, sorted by name:

    cd SCENE && LC_ALL=C sha256sum FILE… | sha256sum

The first 8 digits of each file's own say which one is altered. Files that differ in a number are written together, as a
shell names them: `train/r_{000..149}.png`. A synthetic scene has a manifest in its folder.
"""

from __future__ import annotations

import hashlib
import json
import re
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from datasets.files.atomic_write import write_text
from datasets.files.errors import DataError, SceneError
from datasets.files.numbered_names import expanded, ranges

FOLDER = Path(__file__).with_name("manifests")
OWN = "manifest.yaml"  # in the folder of a synthetic scene
AS_PUBLISHED = "as published"
DIGITS = 8  # of a file's SHA-256


@dataclass(frozen=True)
class SceneFiles:
    sha256: str
    bytes: int
    files: dict[str, str]  # path from the scene's folder -> the first digits of its SHA-256
    folder: str = ""  # in that of the data set, where it is not called as the scene


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
    altered: tuple[str, ...]
    strange: int  # files in the folder that are not in the manifest

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
        tree: Any = yaml.load(path.read_text(encoding="utf-8"), yaml.BaseLoader)  # digits stay text
        scenes = {
            name: SceneFiles(scene["sha256"], int(scene["bytes"]), _files_of(scene["files"]), scene.get("folder", ""))
            for name, scene in tree.pop("scenes").items()
        }
        return Manifest(**{**tree, "scenes": scenes, "faults": tuple(tree.get("faults", ()))})
    except (yaml.YAMLError, KeyError, TypeError, ValueError, AttributeError, OSError) as error:
        raise DataError(path, "a manifest", str(error)) from None


def described(folder: Path, files: list[str]) -> SceneFiles:
    """Of these files, by their paths from `folder`."""
    digests = {name: _sha256(folder / name) for name in sorted(files)}
    total = sum((folder / name).stat().st_size for name in files)
    return SceneFiles(_of_lines(digests), total, {name: digest[:DIGITS] for name, digest in digests.items()})


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
        lines += [f"  {_key(name)}:  # {len(scene.files)} files"]
        lines += [f"    folder: {_key(scene.folder)}"] if scene.folder else []
        lines += [f"    bytes: {scene.bytes}", f"    sha256: {scene.sha256}", "    files:"]
        for pattern, members in ranges(scene.files).items():
            digits = textwrap.wrap(" ".join(scene.files[member] for member in members), 108)
            alone = f" {digits.pop()}" if len(members) == 1 else ""
            lines += [f"      {_key(pattern)}:{alone}", *(f"        {line}" for line in digits)]
    write_text(path, "\n".join(lines) + "\n")


def compared(scene: SceneFiles, folder: Path) -> Found:
    """The files below `folder` with those of the manifest."""
    digests = {name: _sha256(folder / name) for name in sorted(scene.files) if (folder / name).is_file()}
    altered = tuple(name for name, digest in digests.items() if digest[:DIGITS] != scene.files[name])
    below = (path for path in folder.rglob("*") if path.is_file() and path.name != OWN)
    strange = sum(1 for path in below if path.relative_to(folder).as_posix() not in scene.files)
    found = Found(_of_lines(digests), tuple(n for n in scene.files if n not in digests), altered, strange)
    if not str(found) and found.sha256 != scene.sha256:
        raise DataError(folder, f"SHA-256 {scene.sha256[:12]}… of its files", f"{found.sha256[:12]}…")
    return found


def manifest_of(name: str, folder: Path) -> tuple[str, SceneFiles] | None:
    """The name and the files of a scene `dnerf/hook` that is read from `folder`; None where none are published.

    A scene that is not named after its data set, as `auto/hook`, is found by its folder's name and its files'.
    """
    if (folder / OWN).is_file():
        own = read_manifest(folder / OWN)
        return own.name, next(iter(own.scenes.values()))
    data_set, _, scene = name.partition("/")
    if not folder.is_dir():
        return None
    if data_set in names():
        known = published(data_set).scenes.get(scene)
        return (name, known) if known else None
    for other in map(published, names()):
        known = other.scenes.get(scene)
        if known and all((folder / file).is_file() for file in known.files):
            return f"{other.name}/{scene}", known
    return None


def recorded(name: str, folder: Path) -> dict[str, str] | None:
    """What a run keeps of its data: manifest, SHA-256 of the files, how they differ; None: none is published."""
    if (known := manifest_of(name, folder)) is None:
        return None
    found = compared(known[1], folder)
    others = f", and {found.strange} other files" if found.strange else ""
    return {"manifest": known[0], "sha256": found.sha256, "found": f"{str(found) or AS_PUBLISHED}{others}"}


def _of_lines(digests: dict[str, str]) -> str:
    return hashlib.sha256("".join(f"{digest}  {name}\n" for name, digest in digests.items()).encode()).hexdigest()


def _files_of(written: dict[str, str]) -> dict[str, str]:
    files: dict[str, str] = {}
    for pattern, digits in written.items():
        files |= zip(expanded(pattern), digits.split(), strict=True)
    return files


def _key(text: str) -> str:
    """Of YAML."""
    return text if re.fullmatch(r"\w[\w./{}, -]*[\w}]|\w", text) else json.dumps(text, ensure_ascii=False)


def _sha256(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _some(names: tuple[str, ...]) -> str:
    return ", ".join(names[:5]) + (" …" if len(names) > 5 else "")
