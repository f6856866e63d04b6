"""Verdicts on the defaults: whether they are on the Pareto fronts of time and error, given the noise of the times."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.studies.kernel_precision.measure import Errors, Point
from pipeline.studies.kernel_precision.pareto_front import beats, on_front
from pipeline.studies.kernel_precision.variants import AGAIN, DEFAULT, TRADES

_EQUAL_ERRORS = 0.01  # relative difference
_NOISE_QUANTILE = 0.9  # over the kernels, of the relative difference of time between the halves of the rounds


def margins_of(points: Sequence[Point]) -> tuple[float, float]:
    """Relative differences of time (the noise) and of error (1 %) that count as equal."""
    timed = {p.name: p for p in points if p.milliseconds == p.milliseconds}
    noise = float(np.quantile([p.noise for p in timed.values()], _NOISE_QUANTILE))
    if AGAIN in timed:
        noise = max(noise, abs(timed[AGAIN].milliseconds / timed[DEFAULT].milliseconds - 1))
    return noise, _EQUAL_ERRORS


def fronts(points: Sequence[Point], margins: tuple[float, float]) -> tuple[list[bool], list[bool]]:
    """Whether each point is on the front of time and maximum image error, and of time and gradient error."""
    times = [p.milliseconds for p in points]
    return (
        on_front(times, [p.errors.image_max for p in points], margins),
        on_front(times, [p.errors.gradient_rms for p in points], margins),
    )


def verdicts(points: Sequence[Point]) -> list[str]:
    """Sentences from the data: the noise, and whether the default is on the fronts, overall and in each trade-off.

    In a trade-off the errors are `own`.
    """
    timed = [p for p in points if p.milliseconds == p.milliseconds]
    margins = margins_of(timed)
    sentences = [
        f"Noise of the times: {100 * margins[0]:.1f} % (between the halves of the rounds nine in ten kernels differ by "
        "at most this, and so does the default from itself built again).",
        _verdict("all choices together", timed, [p.errors for p in timed], margins),
    ]
    for trade in TRADES:
        group = [p for p in timed if p.trade == trade]
        if len(group) > 1 and trade not in ("several at once", "built again"):
            sentences.append(_verdict(trade, group, [p.own for p in group], margins))
    return sentences


def _verdict(what: str, points: Sequence[Point], errors: Sequence[Errors], margins: tuple[float, float]) -> str:
    at = next(i for i, p in enumerate(points) if p.name == DEFAULT)
    time, parts = points[at].milliseconds, []
    for name, measured in (
        ("maximum image error", [e.image_max for e in errors]),
        ("gradient error", [e.gradient_rms for e in errors]),
    ):
        own = (time, measured[at])
        better = [i for i, p in enumerate(points) if beats((p.milliseconds, measured[i]), own, margins)]
        if not better:
            parts.append(f"on the front of time and {name}")
            continue
        best = min(better, key=lambda i: (measured[i], points[i].milliseconds))
        saved = 1 - points[best].milliseconds / time
        faster = f"takes {100 * saved:.1f} % less time" if saved > margins[0] else "takes equal time within the noise"
        parts.append(
            f'not on the front of time and {name}: "{points[best].label}" {faster}, its error is '
            f"{measured[best]:.1e} against {own[1]:.1e}"
        )
    return f"{what[0].upper()}{what[1:]}: the default is {'; '.join(parts)}."
