"""The table of the measured points: Pareto fronts of time and error, and what beats the default."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from pipeline.runs.run_folder import csv_text
from pipeline.studies.common import markdown_table
from pipeline.studies.kernel_precision.measure import Errors, Point
from pipeline.studies.kernel_precision.variants import AGAIN, DEFAULT, TRADES

Margins = tuple[float, float]  # relative differences of time and of error that count as equal
EXACT: Margins = (0.0, 0.0)
_EQUAL_ERRORS = 0.01
_NOISE_QUANTILE = 0.9  # over the kernels, of the relative difference of time between the halves of the rounds
_FRONTS = {"I": "image_max", "G": "gradient_rms"}  # the errors of the two fronts, fields of Errors
_HEADER = ("variant", "ms", "M pairs", "max", "PSNR", "gradients", "own max", "own gradients", "rounding max", "front")
_NOTES = """\
- ms: forward and backward of the whole workload, CPU time of one thread, minimum; n/a: not measured.
- max, PSNR, gradients: errors of the middle of the image against the float64 reference without thresholds; image in
  [0, 1]. Gradients: RMS error over RMS, root mean square over the parameters' fields. own: against the reference
  without the thresholds that the trade-off varies. rounding: against the reference with the same thresholds.
- front: on the Pareto front of time and maximum image error (I), of time and gradient error (G). Times within the noise
  and errors within 1 % count as equal.
"""


def beats(one: tuple[float, float], other: tuple[float, float], margins: Margins = EXACT) -> bool:
    """Whether `one` (time, error) is at most as large as `other` in both, and smaller in at least one."""
    less = [a < b * (1 - m) for a, b, m in zip(one, other, margins, strict=True)]
    no_more = [a <= b * (1 + m) for a, b, m in zip(one, other, margins, strict=True)]
    return all(no_more) and any(less)


def on_front(time: Sequence[float], error: Sequence[float], margins: Margins = EXACT) -> list[bool]:
    """For each point whether no other beats it. NaN (not measured) is never on the front and beats no point."""
    points = list(zip(time, error, strict=True))
    return [t == t and e == e and not any(beats(other, (t, e), margins) for other in points) for t, e in points]


def margins_of(points: Sequence[Point]) -> Margins:
    """The noise of the times, and 1 % of an error."""
    timed = {p.name: p for p in points if p.milliseconds == p.milliseconds}
    noise = float(np.quantile([p.noise for p in timed.values()], _NOISE_QUANTILE))
    if AGAIN in timed:
        noise = max(noise, abs(timed[AGAIN].milliseconds / timed[DEFAULT].milliseconds - 1))
    return noise, _EQUAL_ERRORS


def fronts(points: Sequence[Point]) -> list[str]:
    """The letters of _FRONTS that each point is on."""
    times, margins = [p.milliseconds for p in points], margins_of(points)
    on = {k: on_front(times, [getattr(p.errors, name) for p in points], margins) for k, name in _FRONTS.items()}
    return ["".join(k for k in _FRONTS if on[k][i]) for i in range(len(points))]


def verdicts(points: Sequence[Point]) -> dict[str, list[str]]:
    """For all choices together, and for each trade-off with its `own` errors: what beats the default, by front."""
    timed, margins = [p for p in points if p.milliseconds == p.milliseconds], margins_of(points)
    found = {"all choices together": _beaten_by(timed, [p.errors for p in timed], margins)}
    for trade in TRADES:
        group = [p for p in timed if p.trade == trade]
        if len(group) > 1 and trade not in ("several at once", "built again"):
            found[trade] = _beaten_by(group, [p.own for p in group], margins)
    return found


def _beaten_by(points: Sequence[Point], errors: Sequence[Errors], margins: Margins) -> list[str]:
    """By each of _FRONTS: the best point that beats the default, or that none does."""
    at, found = next(i for i, p in enumerate(points) if p.name == DEFAULT), []
    for name in _FRONTS.values():
        pairs = [(p.milliseconds, getattr(e, name)) for p, e in zip(points, errors, strict=True)]
        better = [i for i, pair in enumerate(pairs) if beats(pair, pairs[at], margins)]
        best = min(better, key=lambda i: pairs[i][::-1], default=None)
        saved = 0.0 if best is None else 1 - pairs[best][0] / pairs[at][0]
        less = f"{saved:.1%} less time" if saved > margins[0] else "equal time"
        found.append("nothing" if best is None else f"{points[best].label}: {less}, error {pairs[best][1]:.1e}")
    return found


def comma_separated(points: Sequence[Point]) -> str:
    """One line for each point; an empty cell was not measured."""
    kinds = ("errors", "own", "rounding")
    single = [name for name in Point.__dataclass_fields__ if name not in kinds]
    rows = []
    for point, front in zip(points, fronts(points), strict=True):
        fields = asdict(point)
        values = [fields[name] for name in single] + [value for kind in kinds for value in fields[kind].values()]
        cells = ("" if value != value else f"{value:.6g}" if isinstance(value, float) else value for value in values)
        rows.append([*cells, front])
    return csv_text(
        [*single, *(f"{kind}_{name}" for kind in kinds for name in Errors.__dataclass_fields__), "front"], rows
    )


def markdown(points: Sequence[Point], heading: str) -> str:
    """The points, what the columns mean, and the verdicts on the default."""
    rows = []
    for p, front in zip(points, fronts(points), strict=True):
        numbers = (p.errors.gradient_rms, p.own.image_max, p.own.gradient_rms, p.rounding.image_max)
        rows.append(
            [
                p.label,
                "n/a" if p.milliseconds != p.milliseconds else f"{p.milliseconds:.2f}",
                "n/a" if p.pairs != p.pairs else f"{p.pairs / 1e6:.2f}",
                f"{p.errors.image_max:.1e}",
                f"{p.errors.psnr:.2f}",
                *(f"{error:.1e}" for error in numbers),
                front,
            ]
        )
    beaten = [[what, *by] for what, by in verdicts(points).items()]
    return (
        f"### Work and precision of the kernel's numerical choices\n\n{heading}\n\n{markdown_table(_HEADER, rows)}\n\n"
        f"{_NOTES}\nWhat beats the default; the noise of the times is {margins_of(points)[0]:.1%}:\n\n"
        f"{markdown_table(('choice', 'time and image error', 'time and gradient error'), beaten)}\n"
    )
