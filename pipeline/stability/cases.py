"""The named cases: a family, its number, and the bounds that hold there."""

from __future__ import annotations

from dataclasses import dataclass

from .families import FAMILIES, Scene

BOUND = 1e-3  # of full scale in images, of the largest in gradients
STEPS_BOUND = 1e-2  # of the loss after the optimiser's steps, relative to the loss before them


@dataclass(frozen=True)
class Case:
    """One row of the table. `why` says what makes a bound other than BOUND."""

    family: str
    value: float
    image_bound: float = BOUND
    gradient_bound: float = BOUND
    steps_bound: float = STEPS_BOUND
    why: str = ""
    most_steps: int = 100  # less where each takes a second in the twin
    seed: int = 0

    @property
    def name(self) -> str:
        return f"{self.family} {self.value:g}" + (f", seed {self.seed}" if self.seed else "")

    def scene(self) -> Scene:
        return FAMILIES[self.family].build(self.value, self.seed)


VALUES: dict[str, tuple[float, ...]] = {
    "needle": (1, 1e2, 1e4, 1e6, 1e8),
    "pancake": (1e2, 1e4, 1e6, 1e8),
    "long_needle": (1e2, 1e4, 1e6, 1e8),
    "size": (1e-6, 1e-3, 1, 1e3, 1e7),
    "quaternion_length": (1e-44, 1e-40, 1e-20, 1, 1e20, 1e38),
    "quaternion_sign": (0, 1, 2),
    "velocity": (0, 1, 1e2, 1e3, 1e4, 1e5, 1e6),
    "time_scale": (1e-8, 1e-4, 1, 1e3, 1e6),
    "time_scale_separable": (1e-8, 1, 1e6),
    "cut_off": (0.98, 0.995, 0.999999, 1, 1.000001, 1.005, 1.02),
    "outside_the_video": (10, 1e3, 1e9),
    "epoch": (1e-3, 1, 1e5),
    "opacity": (-100, -20, -5.6, 0, 20, 100),
    "stack": (-100, -5.5, -3, 0, 100),
    "near_plane": (-1, -1e-3, 0, 1e-6, 1e-3, 0.1),
    "camera_centre": (0, 1e-6, 1e-3),
    "far": (1e3, 1e5, 1e7),
    "far_from_the_origin": (1e3, 1e5, 1e7),
    "scaled_scene": (1e-4, 1e4),
    "coincident": (1, 2, 100, 10_000),
    "count": (0, 1),
    "wide": (1, 8192),
    "tall": (8192,),
}
MOST_STEPS = {"stack": 20, "coincident": 20, "wide": 20, "tall": 20}
CASES = [Case(family, value, most_steps=MOST_STEPS.get(family, 100))
         for family, values in VALUES.items() for value in values]
