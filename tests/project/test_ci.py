"""`.ci/run` on a small repository, with a make that only prints its target and its folder."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / ".ci" / "run"
MAKE = """#!/bin/sh
echo "$1 in $PWD with $(ls | tr '\\n' ' ')beside $(ls ..); isa '$RASTERIZER_ISA'"
[ "$1" = test ] && echo "===== 7 passed in 1.23s ====="
[ "$1" != "$FAULTY" ]
"""


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """With that make first on the path, and a git that knows no other settings."""
    for path, text in ((tmp_path / "bin" / "make", MAKE), (tmp_path / "none", "")):
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
        path.chmod(0o755)
    (tmp_path / "temporary").mkdir()
    who = {f"GIT_{role}_{key}": "x" for role in ("AUTHOR", "COMMITTER") for key in ("NAME", "EMAIL")}
    return {
        **os.environ,
        **who,
        "GIT_CONFIG_GLOBAL": str(tmp_path / "none"),
        "RASTERIZER_ISA": "v2",
        "PATH": f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}",
        "TMPDIR": str(tmp_path / "temporary"),
    }


@pytest.fixture
def checkout(tmp_path: Path, environment: dict[str, str]) -> Path:
    """Of depth 1; its one commit holds the script and a file."""

    def git(*arguments: str, cwd: Path) -> None:
        subprocess.run(["git", *arguments], cwd=cwd, env=environment, check=True, capture_output=True)

    origin = tmp_path / "origin"
    (origin / ".ci").mkdir(parents=True)
    shutil.copy(SCRIPT, origin / ".ci" / "run")
    git("init", cwd=origin)
    for name in ("old", "kept"):
        (origin / name).touch()
        git("add", "-A", cwd=origin)
        git("commit", "-m", name, cwd=origin)
    git("clone", "--depth", "1", f"file://{origin}", "shallow", cwd=tmp_path)
    return tmp_path / "shallow"


@pytest.mark.parametrize(
    "faulty, status, targets",
    [
        ("", 0, ["lint", "test", "reproduce"]),
        ("lint", 1, ["lint"]),
        ("test", 1, ["lint", "test"]),
        ("reproduce", 1, ["lint", "test", "reproduce"]),
    ],
)
def test_what_is_committed_is_tested_alone_and_removed(
    checkout: Path, environment: dict[str, str], faulty: str, status: int, targets: list[str]
) -> None:
    (checkout / "not_committed").touch()
    done = subprocess.run(
        [checkout / ".ci" / "run"], env={**environment, "FAULTY": faulty}, capture_output=True, text=True
    )
    assert done.returncode == status, done.stderr
    lines = done.stdout.splitlines()
    made = [line for line in lines if " in /" in line]
    assert [line.split()[0] for line in made] == targets
    for line in made:  # in another folder, which holds what was committed, with nothing beside it; nothing is set
        assert str(checkout) not in line and line.endswith("with kept old beside checkout; isa ''")
    assert any("working tree differs" in line for line in lines)
    assert not list((checkout.parent / "temporary").iterdir())
    if status == 0:
        assert lines[-1] == "===== 7 passed in 1.23s ====="
