"""A few cases of every target, all saved inputs of former violations, and the search itself on failing targets."""

from __future__ import annotations

from pathlib import Path

import pytest

from fuzz import failing_targets
from fuzz.__main__ import main, replay
from fuzz.search import search
from fuzz.subprocess_search import fuzz
from fuzz.target import RuleViolation, check_message, load_changes
from fuzz.targets import NAMES, load_target

REGRESSIONS = Path(__file__).parent / "regressions"
SAVED = sorted(path for target in REGRESSIONS.iterdir() for path in target.iterdir())
# Fewer cases for slow targets.
CASES = {"videos": 5, "colmap": 10, "report": 5, "images": 10, "rasterize": 10}


@pytest.mark.parametrize("name", NAMES)
def test_a_few_cases_follow_the_rule(name: str, tmp_path: Path) -> None:
    """The first cases of one seed."""
    target = load_target(name)
    found = search(target, tmp_path / "case", seed=1, cases=CASES.get(name, 20))
    assert found.finding is None, found.finding.error
    assert found.outcomes.total() >= CASES.get(name, 20) // 2  # Hypothesis omits duplicates


@pytest.mark.parametrize("name", NAMES)
def test_example_is_valid(name: str, tmp_path: Path) -> None:
    (tmp_path / "unchanged").mkdir()
    assert replay(name, tmp_path / "unchanged") == "valid"


@pytest.mark.parametrize("saved", SAVED, ids=lambda path: path.relative_to(REGRESSIONS).as_posix())
def test_regressions(saved: Path) -> None:
    replay(saved.parent.name, saved)


@pytest.mark.parametrize(
    ("target", "error"),
    [
        (failing_targets.RAISES, "ZeroDivisionError"),
        (failing_targets.CRASHES, "Aborted"),
        (failing_targets.HANGS, "Timeout"),
    ],
    ids=lambda value: getattr(value, "name", value),
)
def test_violation_is_found_and_its_input_saved(target, error: str, tmp_path: Path) -> None:
    """Also if the process crashes or hangs."""
    report = fuzz(target, seconds=30.0, seed=0, keep=tmp_path)
    assert error in report.error
    (changes,) = load_changes(report.saved).values()
    assert failing_targets.is_invalid(changes)
    assert f"replay: python -m fuzz {target.name} --replay {report.saved}" in report.lines()


def test_finding_is_shrunk(tmp_path: Path) -> None:
    found = search(failing_targets.RAISES, tmp_path / "case", cases=500)
    assert found.finding.changes == {"file": failing_targets.SMALLEST_INVALID}


@pytest.mark.parametrize(
    "line",
    [
        "two\nlines of expected and found in here",
        "here",
        "\x1b[2J expected found here",
        "expected found",
        "here expected found " + "x" * 5000,
    ],
)
def test_invalid_messages(line: str) -> None:
    with pytest.raises(RuleViolation):
        check_message(line, "here")


def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a target that needs no module of the project."""
    monkeypatch.setattr("fuzz.__main__.load_target", lambda name: failing_targets.NEVER_FAILS)
    assert main([]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == list(NAMES)
    assert main(["poses", "--seconds", "0.1", "--keep", str(tmp_path)]) == 0
    assert "no violation" in capsys.readouterr().out and not list(tmp_path.iterdir())
    with pytest.raises(SystemExit):
        main(["nothing"])
    assert "no target nothing; there are checkpoint" in capsys.readouterr().err
