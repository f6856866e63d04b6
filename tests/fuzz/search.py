"""Searches for an input that violates a target's rule: Hypothesis generates cases until the time is up, and shrinks."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import hypothesis
from hypothesis import HealthCheck, Phase, settings

from fuzz.target import Changes, Target, write_files

BATCH = 100  # cases per Hypothesis run
SEEDS = 1_000_003  # stride of seeds, so that batches of different seeds differ


@dataclass(frozen=True)
class Finding:
    """A shrunk case that violates the rule, and its exception."""

    changes: Changes
    error: Exception


@dataclass(frozen=True)
class SearchResult:
    """The result of a search."""

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
) -> SearchResult:
    """Checks cases of `target` for `seconds`, or `cases` of them if that is None, up to the first violation.

    folder: recreated with the files of each case. begin, end: called before and after each case. The same seed gives
    the same cases in the same order.
    """
    example = target.example()
    strategy = target.changes(example)
    outcomes: Counter[str] = Counter()
    failing: list[Finding] = []
    write_files(folder, example)
    target.check(folder)  # late imports happen now, not within the first case
    started = time.monotonic()

    def one(changes: Changes) -> None:
        if seconds is not None and not failing and time.monotonic() - started >= seconds:
            return  # skips the rest of the batch
        begin(changes)
        try:
            write_files(folder, {**example, **changes})
            outcomes[target.check(folder)] += 1
        except Exception as error:
            failing.append(Finding(changes, error))  # the last one is the smallest
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
    batch = 0
    while True:
        try:
            hypothesis.seed(seed * SEEDS + batch)(options(hypothesis.given(strategy)(one)))()
        except Exception:
            if not failing:  # an error of the target's strategy
                raise
            return SearchResult(outcomes, failing[-1])
        if seconds is None or time.monotonic() - started >= seconds:
            return SearchResult(outcomes, None)
        batch += 1
