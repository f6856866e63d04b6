"""The table of PSNR against size and speed."""

from __future__ import annotations

from collections.abc import Sequence

from pipeline.studies.compression.measure import Point


def markdown(points: Sequence[Point], chosen: Point, heading: str, share: float) -> str:
    """One row for each point, with size and speed relative to the full model, which is first.

    chosen: the point in bold. share: part of the schedule of the retraining.
    """
    full = points[0]
    lines = [
        "### PSNR against size and speed",
        "",
        heading,
        "",
        "| Gaussians kept | stored as | MB | MB / full model | FPS | FPS / full model | PSNR, dB | Δ PSNR, dB |",
        "|---:|:---|---:|---:|---:|---:|---:|---:|",
    ]
    for p in points:
        row = (
            f"{p.fraction:.0%}, {p.gaussians:,}",
            p.precision,
            f"{p.megabytes:.2f}",
            f"{p.megabytes / full.megabytes:.2f}",
            f"{p.fps:.0f}",
            f"{p.fps / full.fps:.2f}",
            f"{p.psnr:.2f}",
            f"{p.psnr - full.psnr:+.2f}",
        )
        lines.append("| " + " | ".join(f"**{cell}**" if p is chosen else cell for cell in row) + " |")
    retraining = f"Pruned models are retrained for the last {share:.0%} of the schedule." if share else "No retraining."
    note = (
        "- Bold: the smallest file within the allowed loss of PSNR. Means are always float32; int8 covers the SH "
        f"coefficients but the first, and the rest is float16. {retraining}"
    )
    return "\n".join([*lines, "", note]) + "\n"
