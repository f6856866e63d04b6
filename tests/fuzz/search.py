"""The search for a case that breaks a target's rule: Hypothesis makes cases until the time is up."""

from __future__ import annotations

import itertools
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import hypothesis
from hypothesis import HealthCheck, Phase, settings

from fuzz.target import Changes, Target, write_files

BATCH = 100  # cases that Hypothesis makes at a time
SEEDS = 1_000_003  # batches of one seed that are not another's


@dataclass(frozen=True)
class Finding:
    """A case that breaks the rule, shrunk, and what it raised."""

    changes: Changes
    error: Exception


@dataclass(frozen=True)
class Searched:
    """What a search came to."""

    outcomes: Counter[str]  # how many cases were valid, refused, …
    finding: Finding | None


def search(
    target: Target,
    folder: Path,
    seed: int = 0,
    seconds: float | None = None,
    cases: int = BATCH,
    begin: Callable[[Changes], None] = lambda changes: None,
    end: Callable[[], None] = lambda: None,
) -> Searched:
    """Cases of `target` for `seconds`, or `cases` of them (None); up to the first that breaks the rule.

    folder: where each case's files are written, anew. begin, end: called round each case. The same seed makes the same
    cases in the same order.
    """
    example = target.example()
    strategy = target.changes(example)
    outcomes: Counter[str] = Counter()
    failing: list[Finding] = []
    write_files(folder, example)
    target.check(folder)  # what is imported late is imported now: no case waits for it
    started = time.monotonic()

    def one(changes: Changes) -> None:
        if seconds is not None and not failing and time.monotonic() - started >= seconds:
            return  # the rest of the batch
        begin(changes)
        try:
            write_files(folder, {**example, **changes})
            outcomes[target.check(folder)] += 1
        except Exception as error:
            failing.append(Finding(changes, error))  # the last one is the smallest: shrinking ends with it
            raise
        finally:
            end()

    options = settings(
        max_examples=BATCH if seconds is not None else cases,
        deadline=None,
        database=None,
        report_multiple_bugs=False,
        phases=(Phase.generate, Phase.shrink),
        suppress_health_check=list(HealthCheck),
    )
    for batch in itertools.count():
        try:
            hypothesis.seed(seed * SEEDS + batch)(options(hypothesis.given(strategy)(one)))()
        except Exception:
            if not failing:  # a fault of the target's own changes
                raise
            return Searched(outcomes, failing[-1])
        if seconds is None or time.monotonic() - started >= seconds:
            return Searched(outcomes, None)
