"""Signs that a training has not learnt the scene, for the last line of a run and its metrics.json."""

from __future__ import annotations

FEW_LEFT = 0.01  # of the initial Gaussians; 48 of 20,000 were left where all poses were wrong
NEAR_ZERO = 0.06  # SSIM; a grey image has 0.1 to 0.4 with photographs
CAUSE = "the poses, the times or the unit of length may not be those of the images"


def doubt(initial: int, left: int, densified: bool, ssim: float | None) -> str | None:
    """One line, or None. initial, left: numbers of Gaussians. densified: whether densification was due at all."""
    signs = []
    if left < FEW_LEFT * initial:
        signs.append(f"{left} of {initial} initial Gaussians are left")
    elif densified and left == initial:
        signs.append(f"the {initial} initial Gaussians are all that there are, though densification was due")
    if ssim is not None and ssim < NEAR_ZERO:
        signs.append(f"SSIM is {ssim:.3f}, which is near 0")
    return f"{' and '.join(signs)}: {CAUSE}" if signs else None
