"""What a frame would take if arithmetic and memory were used to the full: the bound that a measured time is held to.

Operations are counted in the kernel's source: one for each addition, multiplication, multiply-add, comparison or minimum
a lane does; moves, masks, shuffles, addresses and branches are free. Bytes are what a stage must read and write if it
finds nothing in the caches and keeps everything it needs twice. The bound is the sum of the two times; a thread
that overlapped them fully could go below it.
"""

from __future__ import annotations

from dataclasses import dataclass

from rasterizer.kernel import kernel
from rasterizer.timing.measure import Counts

GEOMETRY = 4 * 17  # bytes: mean, scale, two quaternions, opacity
LINE = 64  # bytes of a splat, a colour slope, a gradient slot


@dataclass(frozen=True)
class Rates:
    """Of one thread of this machine."""

    operations: float  # a second: lanes of multiply-adds
    bytes: float  # a second, read and written ones counted


@dataclass(frozen=True)
class Work:
    """Of one stage."""

    operations: float
    bytes: float

    def seconds(self, rates: Rates) -> float:
        return self.operations / rates.operations + self.bytes / rates.bytes


def measure_rates() -> Rates:
    return Rates(*kernel.measure_throughput())


def work_of(c: Counts, sh_bytes: int) -> dict[str, Work]:
    """The work of each stage of a frame of a model with 4D rotation; sh_bytes: of a Gaussian's coefficients in use."""
    coefficients = sh_bytes / 4
    return {
        # time row and marginal 105 a Gaussian; slice and projection 380 one alive; Fourier sum and its slope
        # 5/3 a coefficient, basis, colour and its derivatives 360
        "preprocess": Work(
            105 * c.gaussians + 380 * c.alive + (5 / 3 * coefficients + 360) * c.visible,
            GEOMETRY * c.gaussians + (sh_bytes + 2 * LINE + 4) * c.visible,
        ),
        # keys made of depths, and moved in two passes
        "sort": Work(10 * c.visible, (4 + 6 * 8) * c.visible),
        # the quadratic form's largest value in sixteen blocks: 25 operations each
        "intersect_tiles": Work(16 * 25 * c.entries, LINE * c.visible + (12 + 10) * c.entries),
        # offset 2, exponent 5, its power of two 6, cut-offs 2, transmittance 4, colour 3
        "blend": Work(22 * c.pairs, 6 * c.entries + LINE * c.visible + 12 * c.pixels),
        # the same but for the colour 19, along the gradient and what is left 4, inverse 3, ∂alpha 4, moments and sums 11;
        # nine sums over sixteen lanes an entry
        "blend_backward": Work(
            41 * c.pairs + 9 * 15 * c.entries, (10 + LINE) * c.entries + LINE * c.visible + 2 * 12 * c.pixels
        ),
        # slots added up; slice and projection again, then backwards
        "preprocess_backward": Work(
            16 * c.entries + 1100 * c.visible, LINE * c.entries + (3 * GEOMETRY + 2 * LINE + 52) * c.visible
        ),
    }


def bound_ms(work: dict[str, Work], rates: Rates) -> float:
    return 1e3 * sum(stage.seconds(rates) for stage in work.values())
