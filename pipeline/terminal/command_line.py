"""What commands share: a parser, errors of one line, and an end without a word where nobody reads the output."""

from __future__ import annotations

import argparse
import functools
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NoReturn

from pipeline.terminal.streams import keep_printing

CLOSED_PIPE = 141  # 128 + SIGPIPE: the exit status that a shell gives a program which the signal ended


class CommandParser(argparse.ArgumentParser):
    """Parser of `python -m pipeline.<name>`. A wrong option prints one line and exits with status 2."""

    def __init__(self, name: str, description: str | None, epilog: str | None = None) -> None:
        super().__init__(
            prog=f"python -m pipeline.{name}",
            description=description,
            epilog=epilog,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"error: {message}\n")

    def require(self, condition: bool, option: str, expected: str, found: object) -> None:
        """Ends the program with one line unless `condition` holds."""
        if not condition:
            self.error(f"{option}: expected {expected}, found {found}")


def command(main: Callable[[list[str]], int]) -> Callable[..., int]:
    """Decorator of a command's `main(arguments)`; called without arguments it takes those of the command line.

    ValueError and OSError become one line on standard error and exit status 1. A closed pipe ends the program quietly.
    """

    @functools.wraps(main)
    @quiet_on_closed_pipe()
    def run(arguments: list[str] | None = None) -> int:
        keep_printing()
        try:
            return main(sys.argv[1:] if arguments is None else arguments)
        except BrokenPipeError:
            raise
        except (ValueError, OSError) as error:
            print(f"error: {error}", file=sys.stderr)
            return 1

    return run


def log(line: str) -> None:
    """Progress on standard output, shown at once in a pipe too."""
    print(line, flush=True)


@contextmanager
def quiet_on_closed_pipe() -> Iterator[None]:
    """`python -m pipeline.report RUNS | head` is no error: ends with CLOSED_PIPE where nobody reads the output.

    A command should write its files before it prints. Code inside must let BrokenPipeError (an OSError) through.
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
