"""The variants of the kernel that are compared: its defaults, and other values of its numerical choices."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from rasterizer.reference.blend import Thresholds

MACROS = {  # of rasterizer/src/numerical_choices.hpp
    "min_marginal": "RASTERIZER_MIN_MARGINAL",
    "min_alpha": "RASTERIZER_MIN_ALPHA",
    "min_transmittance": "RASTERIZER_MIN_TRANSMITTANCE",
    "exp_degree": "RASTERIZER_EXP_DEGREE",
    "exact_culling": "RASTERIZER_EXACT_CULLING",
    "block_masks": "RASTERIZER_BLOCK_MASKS",
    "float64": "RASTERIZER_FLOAT64",
    "sh_type": "RASTERIZER_SH_TYPE",
}


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

    def definitions(self) -> list[str]:
        """MACRO=value of each choice that differs from the default."""
        default = asdict(NumericalChoices())
        return [f"{MACROS[name]}={_in_cpp(value)}" for name, value in asdict(self).items() if value != default[name]]

    def thresholds(self) -> Thresholds:
        """The same thresholds for the reference implementation."""
        return Thresholds(self.min_marginal, self.min_alpha, self.min_transmittance)


def _in_cpp(value: float | str) -> str:
    return value if isinstance(value, str) else str(int(value)) if isinstance(value, bool) else repr(value)


@dataclass(frozen=True)
class Variant:
    """One kernel of the comparison."""

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


def _digits(value: float) -> str:
    return f"{value:g}".replace(".", "_").replace("-", "m")


def _variant(trade: str, name: str, label: str, **values: Any) -> Variant:
    """Named DEFAULT where `values` are the defaults."""
    choices = NumericalChoices(**values)
    return Variant(DEFAULT if choices == NumericalChoices() else name, trade, label, choices)


def _steps(trade: str, field: str, label: str, *values: float) -> list[Variant]:
    return [
        _variant(trade, f"{field}_{_digits(value)}", label.format(f"{value:g}"), **{field: value}) for value in values
    ]


def all_variants() -> list[Variant]:
    """By trade-off, from coarse to fine; each contains the default."""
    alphas = (("4/255", 4 / 255), ("2/255", 2 / 255), ("1/255", 1 / 255), ("1/510", 1 / 510), ("1/2550", 1 / 2550))
    masks = (
        ("bounding rectangle, whole tiles", False, False),
        ("bounding rectangle, blocks", False, True),
        ("exact, whole tiles", True, False),
        ("exact, blocks", True, True),
    )
    several = (
        ("coarse", 0.1, "2/255", 2 / 255, 1e-3, 3),
        ("default", 0.05, "1/255", 1 / 255, 1e-4, 4),
        ("fine", 0.01, "1/510", 1 / 510, 1e-5, 4),
        ("finest", 1e-4, "1/25500", 1 / 25500, 1e-6, 5),
    )
    precisions = (("bfloat16", "Bfloat16"), ("float16", "Float16"), ("float32", "scalar"))
    return [
        *_steps("temporal cut-off", "min_marginal", "p(t) >= {}", 0.2, 0.1, 0.05, 0.02, 0.01, 1e-3, 1e-4),
        *(
            _variant("alpha cut-off", f"min_alpha_{label.replace('/', '_')}", f"α' >= {label}", min_alpha=value)
            for label, value in alphas
        ),
        *_steps("transmittance stop", "min_transmittance", "T >= {}", 1e-2, 1e-3, 1e-4, 1e-5, 1e-6),
        *_steps("exp degree", "exp_degree", "degree {}", 3, 4, 5),
        *(
            _variant(
                "culling and masks", f"masks_{int(exact)}{int(blocks)}", label, exact_culling=exact, block_masks=blocks
            )
            for label, exact, blocks in masks
        ),
        *(
            _variant("SH precision", f"sh_{name}", f"coefficients in {name}", sh_type=stored)
            for name, stored in precisions
        ),
        _variant("floating point", "float32", "float32"),
        _variant("floating point", "float64", "float64", float64=True),
        *(
            _variant(
                "several at once",
                name,
                f"p >= {p:g}, α' >= {label}, T >= {stop:g}, degree {degree}",
                min_marginal=p,
                min_alpha=alpha,
                min_transmittance=stop,
                exp_degree=degree,
            )
            for name, p, label, alpha, stop, degree in several
        ),
        Variant(DEFAULT, "built again", "default, the package's own"),
        Variant(AGAIN, "built again", "default, again: built as the other rows are"),
    ]


def by_name(name: str) -> Variant:
    return next(variant for variant in all_variants() if variant.name == name)
