"""The table of the measured points, as CSV and Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from pipeline.studies.kernel_precision.measure import Errors, Point
from pipeline.studies.kernel_precision.verdicts import fronts, margins_of, verdicts
from pipeline.studies.output import csv_text

_NOTES = (
    "ms: forward and backward of the whole workload, CPU time of one thread, minimum; n/a: not measured. The reference "
    "implementation holds every (pixel, Gaussian) pair, too many for the whole image.",
    "max, RMS, PSNR, gradients: errors of the middle of the image against the float64 reference without thresholds; "
    "image in [0, 1]. Gradients: RMS error over RMS, root mean square over the parameters' fields.",
    "own: errors against the reference with the same thresholds except those that the trade-off varies: the error of "
    "that choice alone, and of float32.",
    "rounding: errors against the reference with the same thresholds. The maximum includes contributions that rounding "
    "moves across a threshold.",
    "front: I, on the Pareto front of time and maximum image error; G, of time and gradient error; both errors without "
    "thresholds. Times that differ by less than the noise, and errors that differ by less than 1 %, count as equal.",
    "float64: the kernel's source in double precision, parameters and images too. Its vectors of sixteen need twice as "
    "many registers, and exp2 and the like are series to double precision.",
)
_HEADER = (
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
)
_TEXT_COLUMNS = (0, 1, len(_HEADER) - 1)  # left-aligned


def comma_separated(points: Sequence[Point]) -> str:
    """One line for each point; an empty cell was not measured."""
    kinds = ("errors", "own", "rounding")
    single = [name for name in Point.__dataclass_fields__ if name not in kinds]
    errors = [f"{kind}_{name}" for kind in kinds for name in Errors.__dataclass_fields__]
    rows = []
    for point, image, gradient in zip(points, *fronts(points, margins_of(points)), strict=True):
        fields = asdict(point)
        values = [fields[name] for name in single] + [value for kind in kinds for value in fields[kind].values()]
        cells = ("" if value != value else f"{value:.6g}" if isinstance(value, float) else value for value in values)
        rows.append([*cells, int(image), int(gradient)])
    return csv_text([*single, *errors, "on_image_front", "on_gradient_front"], rows)


def markdown(points: Sequence[Point], heading: str) -> str:
    """The table, what its columns mean, and the verdicts on the defaults."""
    front = zip(*fronts(points, margins_of(points)), strict=True)
    body = [_cells(point, *on) for point, on in zip(points, front, strict=True)]
    widths = [max(3, *(len(line[i]) for line in [_HEADER, *body])) for i in range(len(_HEADER))]
    rules = (":" + "-" * (w + 1) if i in _TEXT_COLUMNS else "-" * (w + 1) + ":" for i, w in enumerate(widths))
    lines = [
        "### Work and precision of the kernel's numerical choices",
        "",
        heading,
        "",
        _line(_HEADER, widths),
        "|" + "|".join(rules) + "|",
        *(_line(cells, widths) for cells in body),
        "",
        *(f"- {note}" for note in _NOTES),
        "",
        *(f"- {sentence}" for sentence in verdicts(points)),
    ]
    return "\n".join(lines) + "\n"


def _cells(p: Point, on_image_front: bool, on_gradient_front: bool) -> list[str]:
    own_and_rounding = (p.own.image_max, p.own.gradient_rms, p.rounding.image_max, p.rounding.gradient_rms)
    return [
        p.trade,
        p.label,
        *("n/a" if ms != ms else f"{ms:.2f}" for ms in (p.milliseconds, p.forward_ms)),
        "n/a" if p.pairs != p.pairs else f"{p.pairs / 1e6:.2f}",
        *(f"{error:.1e}" for error in (p.errors.image_max, p.errors.image_rms)),
        f"{p.errors.psnr:.2f}",
        *(f"{error:.1e}" for error in (p.errors.gradient_rms, *own_and_rounding)),
        "I" * on_image_front + "G" * on_gradient_front,
    ]


def _line(cells: Sequence[str], widths: Sequence[int]) -> str:
    padded = (
        cell.ljust(width) if i in _TEXT_COLUMNS else cell.rjust(width)
        for i, (cell, width) in enumerate(zip(cells, widths, strict=True))
    )
    return "| " + " | ".join(padded) + " |"
