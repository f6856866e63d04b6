"""The tables of the study: norms of the gradients, and PSNR with and without clipping."""

from __future__ import annotations

import math

import numpy as np

from pipeline.presentation.seed_statistics import TOO_FEW_SEEDS, compare, estimate
from pipeline.presentation.table import measured
from pipeline.studies.gradient_clipping.clipping_adam import LARGEST
from pipeline.studies.gradient_clipping.training_runs import CaseRuns, Outcome

WINDOW = 50  # iterations before one, whose median norm its norm is compared with


def markdown(runs: list[CaseRuns], heading: str) -> str:
    """Both tables, and what they say."""
    verdicts = {
        f"{found.case.name}, threshold {clipped.quantile:.0%}": verdict(clipped.outcomes, found.unclipped)[1]
        for found in runs
        for clipped in found.clipped
    }
    better = [case for case, word in verdicts.items() if word == "better"]
    if better:
        conclusion = f"Clipping improves PSNR in: {', '.join(better)}."
    elif TOO_FEW_SEEDS in verdicts.values():
        conclusion = "Too few seeds for a verdict in every case."
    else:
        conclusion = (
            "No case, healthy or hostile, shows a benefit beyond two standard errors: the pipeline clips nothing."
        )
    return "\n".join(
        [
            "### Gradient clipping",
            "",
            heading,
            "",
            conclusion,
            "",
            "A small effect is expected. The loss is L1 and SSIM, whose gradient by a pixel is bounded for any image. "
            "Adam divides by the gradient's own size: a step is at most (1 − β₁)/√(1 − β₂) = 3.2 learning rates. "
            "Values that are not finite stop a run (pipeline/training/finite_checks.py).",
            "",
            f"Norms of the batch gradient over the iterations of one run. Spike: the largest ratio of a norm to the "
            f"median of the {WINDOW} norms before it.",
            "",
            "| scene | field | median | 90 % / median | 99 % / median | largest / median | spike |",
            "|:---|:---|---:|---:|---:|---:|---:|",
            *(row for found in runs if found.case.is_healthy for row in norm_rows(found.case.name, found.unclipped[0])),
            "",
            "PSNR of the test views after the last iteration, mean ± standard deviation over seeds. Thresholds are "
            "quantiles of the norms of the healthy case (first seed). Gain: ± 2 standard errors.",
            "",
            "| case | threshold | iterations clipped | PSNR, dB | gain, dB | verdict |",
            "|:---|:---|---:|---:|---:|:---|",
            *(row for found in runs for row in psnr_rows(found)),
            "",
        ]
    )


def norm_rows(name: str, outcome: Outcome) -> list[str]:
    """One row for each field: quantiles of the norms relative to their median."""
    rows = []
    for field, norms in outcome.norms.items():
        middle, ninety, ninety_nine = np.quantile(norms, (0.5, 0.9, 0.99))
        rows.append(
            f"| {name} | {field} | {middle:.2e} | {ninety / middle:.1f} | {ninety_nine / middle:.1f} | "
            f"{norms.max() / middle:.1f} | {spike(norms):.1f} |"
        )
    share = f"{outcome.concentration:.0%} of the squared norm is in {LARGEST:.0%} of the Gaussians"
    return [*rows, f"| {name} | {share} | | | | | |"]


def spike(norms: np.ndarray) -> float:
    """The largest ratio of a norm to the median of the WINDOW norms before it."""
    medians = np.median(np.lib.stride_tricks.sliding_window_view(norms, WINDOW)[:-1], axis=1)
    return float((norms[WINDOW:] / medians).max())


def psnr_rows(found: CaseRuns) -> list[str]:
    """One row without clipping, and one for each threshold."""
    rows = [f"| {found.case.name} | none | | {psnr_text(found.unclipped)} | | |"]
    for clipped in found.clipped:
        gain, word = verdict(clipped.outcomes, found.unclipped)
        fraction = np.mean([o.clipped for o in clipped.outcomes])
        rows.append(
            f"| {found.case.name} | {clipped.quantile:.0%}: {clipped.threshold:.2e} | {fraction:.0%} | "
            f"{psnr_text(clipped.outcomes)} | {gain} | {word} |"
        )
    return rows


def verdict(clipped: list[Outcome], unclipped: list[Outcome]) -> tuple[str, str]:
    """(gain of clipping in dB, better | worse | …), by the rule of the report's ablations."""
    stopped, stopped_without = (sum(math.isnan(o.psnr) for o in outcomes) for outcomes in (clipped, unclipped))
    if stopped or stopped_without:
        word = (
            "better" if stopped < stopped_without else "worse" if stopped > stopped_without else "no difference shown"
        )
        return "n/a", word
    with_clipping, without = estimate([o.psnr for o in clipped]), estimate([o.psnr for o in unclipped])
    assert with_clipping is not None and without is not None  # no PSNR is NaN: no run was stopped
    found = compare(with_clipping, without)
    word = {"worse": "better", "better": "worse"}.get(found.word, found.word)  # it is the verdict on the second
    if math.isnan(found.standard_error):
        return f"{found.difference:+.2f}", word
    return f"{found.difference:+.2f} ± {2 * found.standard_error:.2f}", word


def psnr_text(outcomes: list[Outcome]) -> str:
    """Mean ± standard deviation over seeds, or how many runs were stopped."""
    stopped = sum(math.isnan(o.psnr) for o in outcomes)
    if stopped:
        return f"{stopped} of {len(outcomes)} stopped by the finite checks"
    return measured(estimate([o.psnr for o in outcomes])).text
