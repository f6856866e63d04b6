"""What commands besides `python -m pipeline` share: a parser and errors of one line."""

from __future__ import annotations

import argparse
import functools
import sys
from collections.abc import Callable
from typing import NoReturn

from pipeline.terminal.closed_pipe import quiet_on_closed_pipe


class CommandParser(argparse.ArgumentParser):
    """A wrong option prints one line and exits with status 2."""

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
