"""The variants of the kernel that are compared: its defaults, and other values of its numerical choices."""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass
from fractions import Fraction
from typing import Any

from rasterizer.reference.blend import Thresholds


@dataclass(frozen=True)
class NumericalChoices:
    """The numerical choices of the C++ source and their defaults; a kernel module holds its own as `kernel.choices`."""

    min_marginal: float = 0.05  # Gaussians with a lower p(t) are culled
    min_alpha: float = 1 / 255  # contributions with a lower α' are skipped
    min_transmittance: float = 1e-4  # a pixel ends below it
    exp_degree: int = 4  # of the polynomial of 2^f in α'
    exact_culling: bool = True  # False: by the bounding rectangle of the ellipse
    block_masks: bool = True  # False: a Gaussian is evaluated in all blocks of a tile
    float64: bool = False
    sh_type: str = "scalar"  # type of stored SH coefficients; scalar: the type of everything else

    def flags(self) -> list[str]:
        """-DMACRO=value (rasterizer/src/numerical_choices.hpp) of each choice that differs from the default."""
        values, default = asdict(self), asdict(NumericalChoices())
        changed = {name: value for name, value in values.items() if value != default[name]}
        return [f"-DRASTERIZER_{name.upper()}={_in_cpp(value)}" for name, value in changed.items()]

    def thresholds(self) -> Thresholds:
        return Thresholds(self.min_marginal, self.min_alpha, self.min_transmittance)


def _in_cpp(value: float | str) -> str:
    return value if isinstance(value, str) else str(int(value)) if isinstance(value, bool) else repr(value)


@dataclass(frozen=True)
class Variant:
    name: str  # part of its extension module's name: letters, digits, _
    trade: str  # its trade-off, in TRADES
    label: str
    choices: NumericalChoices = NumericalChoices()

    @property
    def is_built(self) -> bool:
        """Whether the study builds it; the default is the package's kernel."""
        return self.name != DEFAULT


# Trade-off -> thresholds of the reference rendering for its own error: those that it varies are zero.
TRADES = {
    "temporal cut-off": Thresholds(min_marginal=0),
    "alpha cut-off": Thresholds(min_alpha=0),
    "transmittance stop": Thresholds(min_transmittance=0),
    "exp degree": Thresholds(),
    "culling and masks": Thresholds(),
    "SH precision": Thresholds(),
    "floating point": Thresholds(),
    "several at once": Thresholds(0, 0, 0),
    "built again": Thresholds(),
}
DEFAULT = "default"
AGAIN = "again"  # the default choices in a module of their own: its difference in time is noise


def _variant(trade: str, name: str, label: str, **values: Any) -> Variant:
    """Named DEFAULT where `values` are the defaults."""
    choices = NumericalChoices(**values)
    return Variant(DEFAULT if choices == NumericalChoices() else name, trade, label, choices)


def _steps(trade: str, field: str, label: str, *values: float | Fraction) -> list[Variant]:
    shown = [str(value) if isinstance(value, Fraction) else f"{value:g}" for value in values]
    names = [re.sub(r"[./]", "_", text).replace("-", "m") for text in shown]
    numbers = [float(value) if isinstance(value, Fraction) else value for value in values]
    return [
        _variant(trade, f"{field}_{name}", label.format(text), **{field: number})
        for name, text, number in zip(names, shown, numbers)
    ]


def all_variants() -> list[Variant]:
    """By trade-off, from coarse to fine; each contains the default."""
    alphas = [Fraction(4, 255), Fraction(2, 255), Fraction(1, 255), Fraction(1, 510), Fraction(1, 2550)]
    masks = {
        "bounding rectangle, whole tiles": (False, False),
        "bounding rectangle, blocks": (False, True),
        "exact, whole tiles": (True, False),
        "exact, blocks": (True, True),
    }
    several = (
        ("coarse", 0.1, Fraction(2, 255), 1e-3, 3),
        ("default", 0.05, Fraction(1, 255), 1e-4, 4),
        ("fine", 0.01, Fraction(1, 510), 1e-5, 4),
        ("finest", 1e-4, Fraction(1, 25500), 1e-6, 5),
    )
    found = [
        *_steps("temporal cut-off", "min_marginal", "p(t) >= {}", 0.2, 0.1, 0.05, 0.02, 0.01, 1e-3, 1e-4),
        *_steps("alpha cut-off", "min_alpha", "α' >= {}", *alphas),
        *_steps("transmittance stop", "min_transmittance", "T >= {}", 1e-2, 1e-3, 1e-4, 1e-5, 1e-6),
        *_steps("exp degree", "exp_degree", "degree {}", 3, 4, 5),
    ]
    for label, (exact, blocks) in masks.items():
        name = f"masks_{int(exact)}{int(blocks)}"
        found.append(_variant("culling and masks", name, label, exact_culling=exact, block_masks=blocks))
    for name, stored in (("bfloat16", "Bfloat16"), ("float16", "Float16"), ("float32", "scalar")):
        found.append(_variant("SH precision", f"sh_{name}", f"coefficients in {name}", sh_type=stored))
    found.append(_variant("floating point", "float32", "float32"))
    found.append(_variant("floating point", "float64", "float64", float64=True))
    for name, p, alpha, stop, degree in several:
        values = dict(min_marginal=p, min_alpha=float(alpha), min_transmittance=stop, exp_degree=degree)
        label = f"p >= {p:g}, α' >= {alpha}, T >= {stop:g}, degree {degree}"
        found.append(_variant("several at once", name, label, **values))
    found.append(Variant(DEFAULT, "built again", "default, the package's own"))
    found.append(Variant(AGAIN, "built again", "default, again: built as the other rows are"))
    return found
