"""Standard output and error that end no run: of a terminal that lacks characters, and on a full disk."""

from __future__ import annotations

import io
import os
import sys

from datasets.files.atomic_write import NO_SPACE


def keep_printing() -> None:
    """From now on `?` is printed for characters that standard output lacks, and a full disk under it or under standard
    error is said once. Calling it again changes nothing."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # closed
            setattr(sys, name, io.TextIOWrapper(io.BufferedWriter(_Lossy(os.devnull, "w")), "utf-8", "replace"))
            continue
        if type(stream) is not io.TextIOWrapper:  # a notebook's, a test's
            continue
        raw = getattr(stream.buffer, "raw", stream.buffer)  # without a buffer under PYTHONUNBUFFERED
        if not isinstance(raw, io.FileIO) or isinstance(raw, _Lossy):
            continue
        stream.flush()
        opened = io.BufferedWriter(_Lossy(stream.fileno(), "w", closefd=False))
        errors = "replace" if name == "stdout" else stream.errors
        lines, through = stream.line_buffering, stream.write_through
        setattr(sys, name, io.TextIOWrapper(opened, stream.encoding, errors, None, lines, through))


class _Lossy(io.FileIO):
    """A file that drops what a full disk has no room for, and what comes after the error of a closed pipe."""

    _said = False
    _broken = False

    def write(self, data) -> int | None:  # type: ignore[no-untyped-def, override]
        try:
            return super().write(data)
        except OSError as error:
            if error.errno not in NO_SPACE and not self._broken:
                self._broken = True  # what is left in the buffers meets the pipe again when the interpreter ends
                raise
            if error.errno in NO_SPACE and not _Lossy._said:
                _Lossy._said = True
                lost = "no space is left there; the command goes on, and what it prints is lost"
                print(f"warning: standard output or error: {lost}", file=sys.stderr, flush=True)
            return len(data)
