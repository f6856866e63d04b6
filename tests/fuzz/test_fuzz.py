"""Fuzzing: a few cases of every target, every input that was ever found, and the search itself on faulty readers."""

from __future__ import annotations

from pathlib import Path

import pytest

from fuzz import faulty_targets
from fuzz.__main__ import main, replay
from fuzz.search import search
from fuzz.supervise import fuzz
from fuzz.target import RuleBroken, check_line, kept_changes
from fuzz.targets import MODULES, target_of

FOUND = Path(__file__).parent / "found"
KEPT = sorted(path for target in FOUND.iterdir() for path in target.iterdir())
# As many as take half a second at most: hours are for `python -m fuzz`.
CASES = {"videos": 5, "report": 5, "images": 15, "rasterize": 20}


@pytest.mark.parametrize("name", MODULES)
def test_a_few_cases_keep_the_rule(name: str, tmp_path: Path) -> None:
    """The first cases of one seed: the same ones every time."""
    target = target_of(name)
    found = search(target, tmp_path / "case", seed=1, cases=CASES.get(name, 40))
    assert found.finding is None, found.finding.error
    assert found.outcomes.total() >= CASES.get(name, 40) // 2  # Hypothesis leaves out what it has had before


@pytest.mark.parametrize("name", MODULES)
def test_the_example_is_valid(name: str, tmp_path: Path) -> None:
    """Or changes to it would show nothing."""
    (tmp_path / "nothing changed").mkdir()
    assert replay(name, tmp_path / "nothing changed") == "valid"


@pytest.mark.parametrize("kept", KEPT, ids=lambda path: path.relative_to(FOUND).as_posix())
def test_what_was_found_keeps_the_rule_now(kept: Path) -> None:
    replay(kept.parent.name, kept)


@pytest.mark.parametrize(
    "target, fault",
    [
        (faulty_targets.RAISES, "ZeroDivisionError"),
        (faulty_targets.DIES, "Aborted"),
        (faulty_targets.STANDS_STILL, "Timeout"),
    ],
    ids=lambda value: getattr(value, "name", value),
)
def test_a_fault_is_found_and_its_input_kept(target, fault: str, tmp_path: Path) -> None:
    """Also where the process that reads does not live to tell."""
    report = fuzz(target, seconds=30.0, seed=0, keep=tmp_path)
    assert fault in report.fault
    (changes,) = kept_changes(report.kept).values()
    assert faulty_targets.is_bad(changes)
    assert f"replay: python -m fuzz {target.name} --replay {report.kept}" in report.lines()


def test_what_is_found_is_shrunk(tmp_path: Path) -> None:
    found = search(faulty_targets.RAISES, tmp_path / "case", cases=500)
    assert found.finding.changes == {"file": faulty_targets.SMALLEST_BAD}


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
def test_lines_that_are_no_refusal(line: str) -> None:
    with pytest.raises(RuleBroken):
        check_line(line, "here")


def test_the_command_lists_runs_and_refuses(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert main([]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == list(MODULES)
    assert main(["poses", "--seconds", "0.1", "--keep", str(tmp_path)]) == 0
    assert "all keep the rule" in capsys.readouterr().out and not list(tmp_path.iterdir())
    with pytest.raises(SystemExit):
        main(["nothing"])
    assert "no target nothing; there are dnerf" in capsys.readouterr().err
