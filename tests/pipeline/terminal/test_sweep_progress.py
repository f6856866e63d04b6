"""The line of a sweep: how many runs are done, and what is left by the work done so far."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import pytest

from pipeline.terminal.sweep_progress import FOLDER_VARIABLE, TRAINING_SHARE, SweepRun, sweep


def began(seconds_ago: float) -> None:
    """As if the sweep had begun then."""
    plan = Path(os.environ[FOLDER_VARIABLE]) / "plan.json"
    plan.write_text(json.dumps({**json.loads(plan.read_text()), "began": time.time() - seconds_ago}))


def joined(out: str) -> SweepRun:
    run = SweepRun.joined(out)
    assert run is not None
    return run


def trained(out: str) -> None:
    run = joined(out)
    run.update(100, 100)
    run.finished(f"result of {out}")


def test_minutes_left_follow_the_work(capsys: pytest.CaptureFixture) -> None:
    with sweep({"small": 1.0, "large": 3.0, "largest": 4.0}):
        began(600)
        assert joined("small").text() == "0/3 runs"
        trained("small")
        assert capsys.readouterr().out == "1/3 runs, 70 min left  result of small\n"
        joined("large").update(50, 100)
        done = 1 + 3 * TRAINING_SHARE / 2
        assert joined("large").text() == f"1/3 runs, {10 * (8 - done) / done:.0f} min left"
        trained("large")
        trained("largest")
        assert capsys.readouterr().out.endswith("3/3 runs in 10 min  result of largest\n")
    assert FOLDER_VARIABLE not in os.environ


def test_what_was_done_before_says_nothing_about_the_speed(capsys: pytest.CaptureFixture) -> None:
    with sweep({"before": 100.0, "now": 1.0, "later": 1.0}):
        began(600)
        joined("before").finished("result")
        assert capsys.readouterr().out == "1/3 runs  result\n"
        trained("now")
        assert joined("later").text() == "2/3 runs, 10 min left"


def test_what_a_resumed_run_had_done_before_says_nothing_about_the_speed(capsys: pytest.CaptureFixture) -> None:
    with sweep({"resumed": 1.0, "later": 1.0}):
        began(600)
        run = joined("resumed")
        run.update(90, 100, first=80)
        share = TRAINING_SHARE * 0.1  # of a run, in 10 minutes
        assert run.text() == f"0/2 runs, {10 * (2 - TRAINING_SHARE * 0.9) / share:.0f} min left"
        run.finished("result")
        done = 1 - TRAINING_SHARE * 0.8
        assert capsys.readouterr().out == f"1/2 runs, {10 / done:.0f} min left  result\n"


def test_a_failed_run_is_no_longer_to_do(capsys: pytest.CaptureFixture) -> None:
    with sweep({"a": 1.0, "b": 1.0}):
        began(60)
        joined("a").update(50, 100)
        joined("a").failed()
        trained("b")
        assert capsys.readouterr().out == "2/2 runs in 1 min  result of b\n"


def test_on_a_terminal_one_line_is_updated_below_the_results(
    capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    with sweep({"a": 1.0, "b": 1.0}):
        began(600)
        trained("a")
        joined("b").update(50, 100)
    clear, done = "\r\x1b[K", 1 + TRAINING_SHARE / 2
    assert capsys.readouterr().out == (
        f"{clear}0/2 runs, {10 * (2 - TRAINING_SHARE) / TRAINING_SHARE:.0f} min left"
        f"{clear}result of a\n1/2 runs, 10 min left{clear}1/2 runs, {10 * (2 - done) / done:.0f} min left\n"
    )


def test_without_a_sweep_there_is_no_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plan.json").write_text("{}")  # somebody else's
    assert SweepRun.joined("out") is None
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "of another machine"))
    assert SweepRun.joined("out") is None
    monkeypatch.undo()
    with sweep({"another": 1.0}):
        assert SweepRun.joined("out") is None
