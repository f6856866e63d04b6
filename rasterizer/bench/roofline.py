"""A lower bound on a frame's time, and a plot of each stage against it.

The bound is the operations and bytes of each stage, divided by what one thread achieves.
Operations are counted in the kernel's source: one per lane for each addition, multiplication, multiply-add, comparison
or minimum; moves, masks, shuffles, addresses and branches are free. Bytes are what a stage must read and write with
cold caches, each once. The bound is the sum of the two times; a thread that overlapped them fully could be faster.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rasterizer.bench.frame_time import WorkCounts
from rasterizer.kernel_loader import kernel

GEOMETRY = 4 * 17  # bytes of a Gaussian: mean, scale, two quaternions, opacity
LINE = 64  # bytes of a splat, a colour Jacobian, an intersection's gradient: a cache line
MARKERS = "osD^v"  # of the workloads in the plot


@dataclass(frozen=True)
class Rates:
    operations: float  # lanes of multiply-adds per second
    bytes: float  # read plus written, per second


@dataclass(frozen=True)
class Work:
    operations: float
    bytes: float

    def seconds(self, rates: Rates) -> float:
        return self.operations / rates.operations + self.bytes / rates.bytes


def measure_rates() -> Rates:
    return Rates(*kernel.measure_throughput())


def work_of(c: WorkCounts, sh_bytes: int) -> dict[str, Work]:
    """Work by stage of a frame of the full 4D model; sh_bytes: of one Gaussian's active SH coefficients."""
    coefficients = sh_bytes / 4
    return {
        # Per Gaussian: time row and marginal 105. Per alive one: slice and projection 380. Per visible one: Fourier
        # sum and its derivative 5/3 per coefficient, SH basis, colour and its Jacobian 360.
        "preprocess": Work(
            105 * c.gaussians + 380 * c.alive + (5 / 3 * coefficients + 360) * c.visible,
            GEOMETRY * c.gaussians + (sh_bytes + 2 * LINE + 4) * c.visible,
        ),
        # Depth keys, and two passes that move them.
        "sort": Work(10 * c.visible, (4 + 6 * 8) * c.visible),
        # The maximum of the quadratic form in sixteen blocks: 25 each.
        "intersect_tiles": Work(16 * 25 * c.intersections, LINE * c.visible + (12 + 10) * c.intersections),
        # Offset 2, exponent 5, its power of two 6, thresholds 2, transmittance 4, colour 3.
        "blend": Work(22 * c.pairs, 6 * c.intersections + LINE * c.visible + 12 * c.pixels),
        # As blend without the colour 19, colour along the image gradient and its remainder 4, inverse 3, ∂alpha 4,
        # moments and sums 11; per intersection nine sums over sixteen lanes.
        "blend_backward": Work(
            41 * c.pairs + 9 * 15 * c.intersections,
            (10 + LINE) * c.intersections + LINE * c.visible + 2 * 12 * c.pixels,
        ),
        # Intersection gradients summed; slice and projection recomputed, then their gradients.
        "preprocess_backward": Work(
            16 * c.intersections + 1100 * c.visible, LINE * c.intersections + (3 * GEOMETRY + 2 * LINE + 56) * c.visible
        ),
    }


def bound_ms(work: dict[str, Work], rates: Rates) -> float:
    return 1e3 * sum(stage.seconds(rates) for stage in work.values())


def write_roofline(path: Path, rates: Rates, measured: dict[str, tuple[dict[str, Work], dict[str, float]]]) -> None:
    """measured: by workload, the work of each stage and its milliseconds on one thread."""
    import matplotlib  # only the plot needs it

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7.5, 5))
    intensity = np.logspace(-1.5, 2.5, 200)
    axes.plot(
        intensity,
        np.minimum(rates.operations, rates.bytes * intensity) / 1e9,
        color="black",
        lw=1.5,
        label=f"roof: {rates.operations / 1e9:.0f} G operations/s, {rates.bytes / 1e9:.1f} GB/s",
    )
    colors: dict[str, Any] = {}  # by stage
    for marker, (workload, (work, milliseconds)) in zip(MARKERS, measured.items(), strict=False):
        for stage, stage_work in work.items():
            rate = stage_work.operations / (1e-3 * milliseconds[stage]) / 1e9
            (point,) = axes.plot(
                stage_work.operations / stage_work.bytes,
                rate,
                marker,
                color=colors.get(stage),
                ms=7,
                label=stage if stage not in colors else None,
            )
            colors[stage] = point.get_color()
        axes.plot([], [], marker, color="grey", label=workload)
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="operations per byte",
        ylabel="10⁹ operations per second",
        title="Roofline, one thread",
    )
    axes.legend(fontsize=8, loc="lower right")
    axes.grid(alpha=0.3, which="both")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130, bbox_inches="tight")
    plt.close(figure)
