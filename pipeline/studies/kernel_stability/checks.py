"""What the families do not cover, each in a file of its own: a line of the table "Further checks" for each."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Check:
    """One comparison of the kernel with float64."""

    name: str
    compared: str  # what, in words and numbers
    image: float  # largest error of full scale; NaN: not compared
    gradient: float  # largest error of the largest of its tensor; NaN: not compared
    image_bound: float
    gradient_bound: float
    why: str = ""  # where the bounds are from, if they are not the families'

    @property
    def exceeded(self) -> bool:
        """Whether a compared error is above its bound; an infinite one is."""
        pairs = ((self.image, self.image_bound), (self.gradient, self.gradient_bound))
        return any(not math.isnan(error) and not error <= bound for error, bound in pairs)
