"""The measured points as CSV (everything) and Markdown (what is read), and what they say of the defaults."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from pipeline.studies.kernel_precision.measure import Errors, Point
from pipeline.studies.kernel_precision.pareto import beats, on_front
from pipeline.studies.kernel_precision.variants import AGAIN, DEFAULT, TRADES

_NOTES = (
    "ms: forward and backward of the whole workload, CPU time of one thread, minimum; n/a: not measured. The twin "
    "keeps every (pixel, Gaussian) pair, the whole image is beyond it.",
    "Error: of the middle of the image, against the float64 twin that leaves nothing out; image in [0, 1]. Gradients: "
    "RMS error over RMS, root mean square over the parameters' fields.",
    "Own: against the twin with the same thresholds but those of the trade-off, so the error of that choice alone (and "
    "of float32).",
    "Rounding: against the twin with the same thresholds. A contribution that falls on the other side of a threshold "
    "counts in the maximum.",
    "Front: of the points with a time, no other is as fast and as right and better in one of the two, where times "
    "that differ by less than the noise and errors that differ by less than 1 % are equal. I: maximum of the image, G: "
    "gradients, both against the twin that leaves nothing out.",
    "float64: the kernel's source with doubles for floats, parameters and images too: sixteen are twice as many "
    "registers, on vectors as the compiler makes them, exp2 and its like as series of a double's length.",
)


_EQUAL_ERRORS = 0.01
_QUIET = 0.9  # nine in ten kernels' times differ by less than the noise between the two halves of the rounds


def margins_of(points: Sequence[Point]) -> tuple[float, float]:
    """Relative differences of time and of error that say nothing: the noise of the times, and 1 %."""
    timed = {p.name: p for p in points if p.milliseconds == p.milliseconds}
    noise = float(np.quantile([p.noise for p in timed.values()], _QUIET))
    if AGAIN in timed:
        noise = max(noise, abs(timed[AGAIN].milliseconds / timed[DEFAULT].milliseconds - 1))
    return noise, _EQUAL_ERRORS


def fronts(points: Sequence[Point], margins: tuple[float, float]) -> tuple[list[bool], list[bool]]:
    """Whether each is on the front of time against maximum image error, and against gradient error."""
    times = [p.milliseconds for p in points]
    return (
        on_front(times, [p.errors.image_max for p in points], margins),
        on_front(times, [p.errors.gradient_rms for p in points], margins),
    )


def comma_separated(points: Sequence[Point]) -> str:
    """One line a point; an empty cell was not measured."""
    kinds = ("errors", "own", "rounding")
    single = [name for name in Point.__dataclass_fields__ if name not in kinds]
    head = single + [f"{kind}_{name}" for kind in kinds for name in Errors.__dataclass_fields__]
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow([*head, "on_image_front", "on_gradient_front"])
    for point, image, gradient in zip(points, *fronts(points, margins_of(points)), strict=True):
        fields = asdict(point)
        values = [fields[name] for name in single] + [value for kind in kinds for value in fields[kind].values()]
        writer.writerow(
            [
                *("" if value != value else f"{value:.6g}" if isinstance(value, float) else value for value in values),
                int(image),
                int(gradient),
            ]
        )
    return buffer.getvalue()


def markdown(points: Sequence[Point], heading: str) -> str:
    """heading: workload, machine, date and command, in one line."""
    head = [
        "",
        "variant",
        "ms",
        "forward",
        "M pairs",
        "max",
        "RMS",
        "PSNR",
        "gradients",
        "own max",
        "own gradients",
        "rounding max",
        "rounding gradients",
        "front",
    ]
    body = []
    for p, image, gradient in zip(points, *fronts(points, margins_of(points)), strict=True):
        body.append(
            [
                p.trade,
                p.label,
                *(_time(t) for t in (p.milliseconds, p.forward_ms)),
                "n/a" if p.pairs != p.pairs else f"{p.pairs / 1e6:.2f}",
                *map(_error, (p.errors.image_max, p.errors.image_rms)),
                f"{p.errors.psnr:.2f}",
                *map(
                    _error,
                    (
                        p.errors.gradient_rms,
                        p.own.image_max,
                        p.own.gradient_rms,
                        p.rounding.image_max,
                        p.rounding.gradient_rms,
                    ),
                ),
                "I" * image + "G" * gradient,
            ]
        )
    widths = [max(3, *(len(line[i]) for line in [head, *body])) for i in range(len(head))]
    words = {0, 1, len(head) - 1}

    def line(cells: list[str]) -> str:
        return (
            "| "
            + " | ".join(
                c.ljust(w) if i in words else c.rjust(w) for i, (c, w) in enumerate(zip(cells, widths, strict=True))
            )
            + " |"
        )

    rules = (":" + "-" * (w + 1) if i in words else "-" * (w + 1) + ":" for i, w in enumerate(widths))
    return (
        "\n".join(
            [
                "### Work and precision of the kernel's choices",
                "",
                heading,
                "",
                line(head),
                "|" + "|".join(rules) + "|",
                *map(line, body),
                "",
                *(f"- {note}" for note in _NOTES),
                "",
                *(f"- {sentence}" for sentence in verdicts(points)),
            ]
        )
        + "\n"
    )


def _time(ms: float) -> str:
    return "n/a" if ms != ms else f"{ms:.2f}"


def _error(value: float) -> str:
    return f"{value:.1e}"


def verdicts(points: Sequence[Point]) -> list[str]:
    """One sentence each, from the data: on the whole and in each trade-off, whether the default lies on the front.

    In a trade-off the errors are its own.
    """
    timed = [p for p in points if p.milliseconds == p.milliseconds]
    margins = margins_of(timed)
    said = [
        f"Noise of the times: {100 * margins[0]:.1f} % (between halves of the rounds nine in ten kernels differ by "
        "no more, nor does the default from itself built again).",
        _verdict("all choices together", timed, [p.errors for p in timed], margins),
    ]
    for trade in TRADES:
        group = [p for p in timed if p.trade == trade]
        if len(group) > 1 and trade not in ("several at once", "built again"):
            said.append(_verdict(trade, group, [p.own for p in group], margins))
    return said


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
        quicker = f"takes {100 * saved:.1f} % less time" if saved > margins[0] else "takes as long, within the noise"
        parts.append(
            f'not on the front of time and {name}: "{points[best].label}" {quicker}, its error is '
            f"{measured[best]:.1e} against {own[1]:.1e}"
        )
    return f"{what[0].upper()}{what[1:]}: the default is {'; '.join(parts)}."
