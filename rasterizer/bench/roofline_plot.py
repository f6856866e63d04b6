"""The roofline plot: each stage's throughput against the machine's arithmetic and memory limits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from rasterizer.bench.roofline_model import Rates, Work

MARKERS = "osD^v"


def write_roofline(path: Path, rates: Rates, measured: dict[str, tuple[dict[str, Work], dict[str, float]]]) -> None:
    """measured: by workload, the work of each stage and its milliseconds on one thread."""
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
