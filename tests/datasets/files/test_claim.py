"""The claim of a folder, between processes of one machine and of several.

Another machine is a process whose claim has another machine's name: its `flock` is then not asked, only its time.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from shell import FORKING

from datasets.files import claim
from datasets.files.claim import Busy, Claim, Lost, claimed, wait_until_free

BEAT_S, EXPIRES_S = 0.1, 2.0  # a sign of life twenty times before a claim expires: a busy machine delays some


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(claim, "BEAT_S", BEAT_S)
    monkeypatch.setattr(claim, "EXPIRES_S", EXPIRES_S)


def _on_machine(name: str, target: Callable[..., None], arguments: tuple) -> None:
    claim.BEAT_S, claim.EXPIRES_S = BEAT_S, EXPIRES_S
    if name:
        claim._this_machine = lambda: name
    target(*arguments)


def start(machine: str, target: Callable[..., None], *arguments: Any):
    """machine: empty for this one."""
    process = FORKING.Process(target=_on_machine, args=(machine, target, arguments))
    process.start()
    return process


def _hold(folder: Path, until: Path) -> None:
    with Claim(folder):
        (folder / "held").touch()
        while not until.exists():
            time.sleep(0.01)


def holder(machine: str, folder: Path, until: Path):
    """A process that holds the folder until a file appears."""
    process = start(machine, _hold, folder, until)
    while not (folder / "held").exists():
        assert process.is_alive()
        time.sleep(0.01)
    return process


def _count(folder: Path, times: int) -> None:
    """Adds 1 to the number in a file, without any other protection than the claim."""
    for _ in range(times):
        with claimed(folder, lambda: None):
            number = int((folder / "number").read_text())
            time.sleep(0.002)
            (folder / "number").write_text(str(number + 1))


@pytest.mark.parametrize("machines", [("", "", "", ""), ("a", "b", "c", "")])
def test_one_at_a_time(tmp_path: Path, machines: tuple[str, ...]) -> None:
    (tmp_path / "number").write_text("0")
    processes = [start(machine, _count, tmp_path, 8) for machine in machines]
    for process in processes:
        process.join(60)
        assert process.exitcode == 0
    assert (tmp_path / "number").read_text() == "32", "two were in the folder at once"
    assert len(list(tmp_path.glob(f"{claim.NAME}*"))) == 1


def test_of_those_who_find_a_dead_claim_one_succeeds_it(tmp_path: Path) -> None:
    """Each finds it expired at the same moment; those that come late find the successor alive."""
    for round in range(5):
        folder = tmp_path / str(round)
        folder.mkdir()
        (folder / f"{claim.NAME}7").write_text("another start of another machine\nhost, process 1")
        os.utime(folder / f"{claim.NAME}7", (1, 1))
        at_once, taken = threading.Barrier(8), []

        def take(folder=folder, at_once=at_once, taken=taken) -> None:
            at_once.wait()
            with suppress(Busy):
                taken.append(Claim(folder))

        threads = [threading.Thread(target=take) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(taken) == 1 and [path.name for path in folder.iterdir()] == [f"{claim.NAME}8"]
        taken[0].release()


def test_a_killed_process_of_this_machine_holds_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(claim, "EXPIRES_S", 1e6)
    process = holder("", tmp_path, tmp_path / "end")
    with pytest.raises(Busy, match=rf"another process at work in it \(.*, process {process.pid}\)"):
        Claim(tmp_path)
    process.kill()
    process.join()
    Claim(tmp_path).release()


def test_a_process_of_another_machine_is_known_by_its_signs_of_life(tmp_path: Path) -> None:
    process = holder("another", tmp_path, tmp_path / "end")
    with pytest.raises(Busy, match=f"process {process.pid}"):
        Claim(tmp_path)
    process.kill()
    killed = time.monotonic()
    Claim(tmp_path).release()  # waits until the claim has expired
    assert time.monotonic() - killed > EXPIRES_S / 2


def test_clocks_of_the_machines_may_differ(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    process = holder("another", tmp_path, tmp_path / "end")
    for wrong_by in (-1e6, 1e6):
        monkeypatch.setattr(claim.time, "time", lambda wrong_by=wrong_by: 1.8e9 + wrong_by)
        with pytest.raises(Busy):
            Claim(tmp_path)
    process.kill()


def test_a_released_folder_is_free_for_every_machine(tmp_path: Path) -> None:
    process = holder("another", tmp_path, tmp_path / "end")
    (tmp_path / "end").touch()
    wait_until_free(tmp_path)
    with Claim(tmp_path):
        pass
    process.join()
    assert process.exitcode == 0


def test_a_process_that_stood_still_is_told_that_it_was_taken_over(tmp_path: Path) -> None:
    """As on a machine that was suspended."""
    mine = Claim(tmp_path)
    mine.check()
    (tmp_path / f"{claim.NAME}2").touch()  # what another machine makes, when this one is taken for dead
    deadline = time.monotonic() + 30
    with pytest.raises(Lost, match="another process, which took it over after this one had stood still"):
        while time.monotonic() < deadline:
            mine.check()
            time.sleep(0.01)
    mine.release()


def test_a_stopped_process_is_succeeded_and_then_told(tmp_path: Path) -> None:
    process = start("another", _hold_and_check, tmp_path)
    while not (tmp_path / "held").exists():
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGSTOP)
    with Claim(tmp_path):
        os.kill(process.pid, signal.SIGCONT)
        process.join(30)
    assert (tmp_path / "told").exists() and process.exitcode == 0


def _hold_and_check(folder: Path) -> None:
    mine = Claim(folder)
    (folder / "held").touch()
    try:
        while True:
            mine.check()
    except Lost:
        (folder / "told").touch()
