"""A folder that is written whole or not at all."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from datasets.files.atomic_write import writing


@contextmanager
def atomic_folder(folder: Path, proof: str = "meta.json") -> Iterator[Path]:
    """A folder to write into, which becomes `folder` at the end.

    It lies beside it until then: a killed run leaves no half folder, and of two processes that make the same one the
    first one's stands. proof: a file that is in every finished one.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    with writing(folder), tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}-") as temporary:
        draft = Path(temporary) / folder.name  # a plain folder: the temporary one is private to its owner
        draft.mkdir()
        yield draft
        try:
            os.rename(draft, folder)
        except OSError:
            if not (folder / proof).is_file():  # not another process's finished copy
                raise


def write_json(path: Path, content: dict) -> None:
    path.write_text(json.dumps(content, indent=1) + "\n")
