"""Output on a full disk (/dev/full), in ASCII, and where it is closed: real streams of real processes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
SAY = "import sys; from pipeline.terminal.streams import keep_printing as k; k(); k(); print('a · b', flush=True); "


def run(*arguments: str, shell: str = "", **environment: str) -> tuple[int, str, str]:
    """(exit status, standard output, standard error). shell: redirections."""
    command = ["bash", "-c", f'exec "$@" {shell}', "bash", sys.executable, *arguments]
    done = subprocess.run(
        command, cwd=ROOT, env=os.environ | environment, capture_output=True, encoding="utf-8", timeout=60
    )
    return done.returncode, done.stdout, done.stderr


def test_characters_that_a_terminal_lacks_are_replaced() -> None:
    assert run("-c", SAY, PYTHONIOENCODING="ascii") == (0, "a ? b\n", "")
    assert run("-c", SAY, PYTHONIOENCODING="utf-8") == (0, "a · b\n", "")
    assert run("-c", "print('·')", PYTHONIOENCODING="ascii")[0] == 1, "the test above would see it"


@pytest.mark.parametrize("arguments", [("pipeline", "--help"), ("pipeline.export", "--help")])
def test_every_command_prints_in_ascii(arguments: tuple[str, ...]) -> None:
    status, out, err = run("-m", *arguments, PYTHONIOENCODING="ascii")
    assert (status, err) == (0, "") and "?" in out


def test_a_full_disk_is_said_once_and_the_command_goes_on() -> None:
    code = SAY + "print('more', flush=True); print('done', file=sys.stderr)"
    status, _, err = run("-c", code, shell="> /dev/full")
    assert status == 0 and err.count("no space is left") == 1 and err.endswith("\ndone\n")
    assert run("-c", code, shell="> /dev/full 2>&1") == (0, "", "")
    assert run("-c", "print('·', flush=True)", shell="> /dev/full")[0] == 1, "the test above would see it"


def test_closed_output_is_nowhere() -> None:
    assert run("-c", SAY + "print('done', file=sys.stderr)", shell=">&-") == (0, "", "done\n")
