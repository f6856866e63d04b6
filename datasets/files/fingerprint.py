"""Hash of large files by their ends."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path

from datasets.files.errors import SceneError


def fingerprint(paths: Sequence[Path], part: int) -> str:
    """Hash of the name, the size, and the first and last `part` bytes of each file."""
    digest = hashlib.blake2b(digest_size=16)
    for path in paths:
        try:
            with open(path, "rb") as file:
                size = file.seek(0, os.SEEK_END)
                digest.update(f"{path.name}\n{size}\n".encode())
                file.seek(0)
                digest.update(file.read(part))
                file.seek(max(size - part, 0))
                digest.update(file.read(part))
        except OSError as error:
            raise SceneError(path, "a readable file", str(error)) from None
    return digest.hexdigest()
