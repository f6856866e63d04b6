"""Files written whole or not at all, and errors of writing that name the file."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

# No room: on the device, in the user's quota, below the process's file size limit.
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
TEMPORARY = ".tmp-"  # how the names of unfinished files begin
_FULL_BYTES = 2**20  # less free space than this is none; numpy's errors of writing do not say why


class DiskFull(OSError):
    """There is no room for a file. One line: which, and what to do."""


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Errors of the operating system inside name `path`; DiskFull where there is no room for it."""
    try:
        yield
    except DiskFull:
        raise
    except OSError as error:
        if error.errno in _NO_ROOM or (error.errno is None and _free_bytes(path) < _FULL_BYTES):
            raise DiskFull(
                f"{path}: expected room to write it, found no space left ({_free_bytes(path) / 1e6:.0f} MB "
                "free); make room and give the same command again: what was finished is kept"
            ) from error
        if error.errno is not None and error.filename is None:
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """A temporary path of the same suffix beside `path`, renamed over it at the end if nothing went wrong.

    Synced to the disk first: after a power cut, too, the name holds the old file or the new one, whole.
    """
    temporary = path.with_name(f"{TEMPORARY}{path.name}")
    try:
        with writing(path):
            yield temporary
            _sync(temporary)
            os.replace(temporary, path)
            _sync(path.parent)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Replace `path` by `text`, whole or not at all."""
    with atomic_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _free_bytes(path: Path) -> int:
    folder = path if path.is_dir() else path.parent
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return 0


def _sync(path: Path) -> None:
    """Force a file, or a directory's entries, to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
