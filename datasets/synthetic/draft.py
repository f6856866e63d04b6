"""A folder that is written whole or not at all."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def draft_of(folder: Path) -> Iterator[Path]:
    """A folder to write into, which becomes `folder` at the end; the last thing written is its meta.json.

    It lies beside it until then: a killed run leaves no half scene, and of two processes that make the same
    scene the first one's stands.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}-") as temporary:
        draft = Path(temporary) / folder.name  # a plain folder: the temporary one is private to its owner
        draft.mkdir()
        yield draft
        try:
            os.rename(draft, folder)
        except OSError:
            if not (folder / "meta.json").is_file():  # not another process's finished copy
                raise


def write_json(path: Path, content: dict) -> None:
    path.write_text(json.dumps(content, indent=1) + "\n")
