"""Plot colours for light and dark pages."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Theme:
    """Colours on one background. The palette is safe for colour-blind readers (after Okabe and Ito)."""

    ink: str
    faint: str
    lines: tuple[str, ...]  # of models: full, no_4drot, no_4dsh, no_time_split, and the last for others; else in order


LIGHT = Theme("#1d2430", "#d9dde3", ("#0072b2", "#d55e00", "#009e73", "#b5519b", "#e69f00", "#56b4e9", "#7a7f87"))
DARK = Theme("#e4e7ec", "#3a414d", ("#5ab6f0", "#f2955c", "#3ccb9e", "#e39bcf", "#f5c454", "#a9dcf5", "#a6abb3"))
