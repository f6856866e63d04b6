"""A command whose reader stops reading: real pipes, real processes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
COMMAND = """
import sys
from pipeline.terminal.command_line import quiet_on_closed_pipe

@quiet_on_closed_pipe()
def main():
    {body}

sys.exit(main())
"""


def run(body: str, *, read: int, stderr_too: bool = False) -> tuple[int, str, str]:
    """(exit status, what was read, what stood on standard error) of a process of whose output `read` characters are
    read before the pipe is closed."""
    process = subprocess.Popen(
        [sys.executable, "-c", COMMAND.format(body=body)],
        cwd=ROOT,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT if stderr_too else subprocess.PIPE,
    )
    said = process.stdout.read(read)
    process.stdout.close()
    errors = "" if stderr_too else process.stderr.read()
    return process.wait(timeout=60), said, errors


LONG = "[print('x' * 1000) for _ in range(10000)]"  # ten times what the system's pipe holds and more


def test_a_reader_that_stops_ends_the_command_quietly() -> None:
    assert run(LONG, read=1000) == (141, "x" * 1000, "")


def test_without_the_helper_there_is_a_traceback() -> None:
    """The test above would see one."""
    process = subprocess.Popen([sys.executable, "-c", LONG], text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.read(1000)
    process.stdout.close()
    assert "BrokenPipeError" in process.stderr.read() and process.wait(timeout=60) == 1


@pytest.mark.parametrize(
    "body",
    [
        "import time; time.sleep(0.5); print('one line')",  # it stays in the buffer until the end
        "import time; time.sleep(0.5); print('one line'); sys.exit(0)",
    ],
)
def test_a_line_still_in_the_buffer_when_the_reader_has_gone(body: str) -> None:
    assert run(body, read=0) == (141, "", "")


def test_standard_error_in_the_same_pipe() -> None:
    body = "[print('x' * 1000, file=stream) for _ in range(10000) for stream in (sys.stderr, sys.stdout)]"
    assert run(body, read=1000, stderr_too=True)[0] == 141


@pytest.mark.parametrize("body, status", [("return 3", 3), ("sys.exit(2)", 2), ("print('done')", 0)])
def test_a_command_that_is_read_to_its_end_keeps_its_exit_status(body: str, status: int) -> None:
    assert run(body, read=-1)[0] == status


def test_another_error_stays_one() -> None:
    status, _, errors = run("raise RuntimeError('mine')", read=-1)
    assert status == 1 and "RuntimeError: mine" in errors
