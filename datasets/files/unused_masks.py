"""Masks that lie beside images and that nothing names: they are not used, and a line says so."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

FOLDERS = ("masks", "mask")
ENDING = "_mask"  # of the name of a file beside its image, before the suffix


def is_mask(path: Path) -> bool:
    """Whether a file is, by its name, the mask of the image beside it: 0001_mask.png."""
    return path.stem.lower().endswith(ENDING)


def unused_masks(images: Collection[Path]) -> str | None:
    """`DIR/masks (31 files), DIR/images/*_mask.png (2 files)`; None without any. images: those in use."""
    own = {image.resolve() for image in images}
    found = []
    for folder in sorted({image.parent for image in images}):
        for masks in (near / name for near in (folder.parent, folder) for name in FOLDERS):
            count = sum(file.is_file() and file.resolve() not in own for file in masks.rglob("*"))
            if count:
                found.append(f"{masks} ({count} files)")
        count = sum(is_mask(file) and file.resolve() not in own for file in folder.iterdir())
        if count:
            found.append(f"{folder}/*{ENDING}.* ({count} files)")
    return ", ".join(dict.fromkeys(found)) or None
