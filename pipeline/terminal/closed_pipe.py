"""Closed pipes are no error: `python -m pipeline.report RUNS | head` ends quietly.

    @quiet_on_closed_pipe()
    def main() -> int: ...

A command should write its files before it prints: printing stops when the pipe is closed.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

CLOSED_PIPE = 141  # 128 + SIGPIPE: the exit status that a shell gives a program which the signal ended


@contextmanager
def quiet_on_closed_pipe() -> Iterator[None]:
    """Ends the program with CLOSED_PIPE and without a word where standard output or error is a pipe that nobody reads.

    As a context manager or, called, as a decorator. Code inside must let BrokenPipeError (an OSError) through.
    """
    try:
        try:
            yield
        except SystemExit:  # as of --help
            sys.stdout.flush()
            raise
        sys.stdout.flush()  # what is still in the buffer meets a closed pipe here, not when the interpreter ends
    except BrokenPipeError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for stream in (sys.stdout, sys.stderr):
            try:
                stream.flush()
            except BrokenPipeError:  # what is left in its buffer must have somewhere to go when the interpreter ends
                os.dup2(nowhere, stream.fileno())
        raise SystemExit(CLOSED_PIPE) from None
