"""Atomic writes: a file or folder appears complete or not at all. Errors of the disk name the path."""

from __future__ import annotations

import errno
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

TEMPORARY = ".tmp-"  # prefix of the names of incomplete files
NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # disk, user's quota, file size limit of the process
# Some libraries (numpy) raise OSError without errno. With less free space than this the disk is taken to be full.
_FULL_BYTES = 2**20


class DiskFull(OSError):
    """No space is left for a file. One line: the path and what to do."""


@contextmanager
def disk_errors_named(path: Path) -> Iterator[None]:
    """An OSError raised in the block names `path`. It becomes DiskFull where no space is left."""
    try:
        yield
    except DiskFull:
        raise
    except OSError as error:
        if error.errno in NO_SPACE or (error.errno is None and _free_bytes(path) < _FULL_BYTES):
            raise DiskFull(
                f"{path}: expected room to write it, found no space left ({_free_bytes(path) / 1e6:.0f} MB "
                "free); make room and give the same command again: what was finished is kept"
            ) from error
        if error.errno is not None and error.filename is None:
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Yields a temporary path beside `path`, with its suffix, and renames it to `path` unless the block raises.

    The file is synced before the rename: even after a power cut `path` is the complete old file or the new one.
    """
    temporary = path.with_name(f"{TEMPORARY}{path.name}")
    try:
        with disk_errors_named(path):
            yield temporary
            _sync(temporary)
            os.replace(temporary, path)
            _sync(path.parent)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def atomic_folder(folder: Path, marker: str) -> Iterator[Path]:
    """Yields an empty folder beside `folder` and renames it to `folder` unless the block raises.

    marker: name of a file that every complete folder holds. If another process completed `folder` first, that copy
    stays and this one is deleted.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    with disk_errors_named(folder), tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}-") as parent:
        temporary = Path(parent) / folder.name  # a subfolder: TemporaryDirectory itself is private to its user
        temporary.mkdir()
        yield temporary
        try:
            os.rename(temporary, folder)
        except OSError:
            if not (folder / marker).is_file():
                raise


def write_text(path: Path, text: str) -> None:
    """Replaces `path` atomically by UTF-8 text."""
    with atomic_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, value: Any, indent: int = 2) -> None:
    """Replaces `path` atomically by JSON. ValueError for NaN and infinity, which JSON lacks."""
    write_text(path, json.dumps(value, indent=indent, allow_nan=False) + "\n")


def _free_bytes(path: Path) -> int:
    folder = path if path.is_dir() else path.parent
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return 0


def _sync(path: Path) -> None:
    """Flushes a file, or the entries of a directory, to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
