"""The tables on the terminal: PSNR of training and held-out views, and error by motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.studies.overfitting.error_by_motion import ErrorByMotion
from pipeline.studies.overfitting.history import History

ONE_VIEW = 1.5  # a Gaussian with a lower effective view count is constrained by one view at most


def summary(histories: Sequence[History], view_counts: Sequence[np.ndarray]) -> str:
    """One line for each run, after its last evaluation. view_counts: (N,) for each run."""
    lines = [
        f"{'run':30} {'train dB':>9} {'held-out dB':>12} {'Gaussians':>10} {'one view only':>14} "
        f"{'median lifetime, frames':>24}"
    ]
    for run, counts in zip(histories, view_counts):
        lifetime = "–" if run.lifetimes is None else f"{run.lifetimes[-1, 2]:.1f}"
        lines.append(
            f"{run.label:30} {run.train_psnr[-1]:9.2f} {run.psnr[-1]:12.2f} {len(counts):10,} "
            f"{np.mean(counts < ONE_VIEW):14.0%} {lifetime:>24}"
        )
    return "\n".join(lines)


def motion_summary(histories: Sequence[History], errors: Sequence[ErrorByMotion]) -> str:
    """One line for each run."""
    lines = [f"{'run':30} {'moving pixels':>14} {'error in them':>14} {'moving dB':>10} {'static dB':>10}"]
    for run, e in zip(histories, errors):
        lines.append(
            f"{run.label:30} {e.moving_fraction:14.1%} {e.moving_error:14.0%} {e.moving_psnr:10.2f} "
            f"{e.static_psnr:10.2f}"
        )
    return "\n".join(lines)
