"""python -m datasets verify dnerf DIR: whether a data set's files are those of its manifest."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from datasets.files.errors import SceneError
from datasets.manifest import OWN, Manifest, compared, names, published, read_manifest


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m datasets",
        description="Compares the files of a data set with its manifest and names what is missing or altered.",
        epilog="Exit status: 0 where every file is as published, else 1.",
    )
    verify = parser.add_subparsers(required=True, metavar="verify").add_parser("verify")
    verify.add_argument("name", metavar="NAME", help=f"{', '.join(names())}; dnerf/hook for one scene; synthetic/wheel")
    verify.add_argument("folder", type=Path, metavar="DIR", help="folder of the data set, or of the one scene")
    options = parser.parse_args(arguments)
    try:
        return _verify(options.name, options.folder)
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1


def _verify(name: str, folder: Path) -> int:
    if not folder.is_dir():
        raise SceneError(folder, "a folder of the data set", "a file" if folder.exists() else "nothing there")
    manifest, of_scene = _manifest(name, folder)
    for line in (f"{manifest.title}, from {manifest.source}; licence: {manifest.licence}", *manifest.faults):
        print(line)
    wrong = 0
    for scene, known in manifest.scenes.items():
        if of_scene and scene != of_scene:
            continue
        found = compared(known, folder if of_scene else folder / (known.folder or scene))
        wrong += bool(str(found))
        more = f"; {found.strange} other files, which the manifest lacks" if found.strange else ""
        as_published = f"as published, {len(known.files)} files, {known.bytes} bytes, SHA-256 {found.sha256}"
        print(f"{scene}: {str(found) or as_published}{more}")
    return 1 if wrong else 0


def _manifest(name: str, folder: Path) -> tuple[Manifest, str]:
    """And the one scene that is asked for; "": all."""
    data_set, _, scene = name.partition("/")
    if data_set == "synthetic":
        if not (folder / OWN).is_file():
            raise SceneError(folder, f"a synthetic scene with {OWN}", "none; python -m datasets.synthetic makes one")
        own = read_manifest(folder / OWN)
        if name != own.name:
            raise SceneError(folder, name, own.name)
        return own, scene
    manifest = published(data_set)
    if scene and scene not in manifest.scenes:
        raise SceneError(data_set, f"one of {', '.join(manifest.scenes)}", scene)
    return manifest, scene


if __name__ == "__main__":
    sys.exit(main())
