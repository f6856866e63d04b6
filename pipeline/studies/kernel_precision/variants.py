"""Which numerical choices are compared: the kernel as it is, and with one of its choices made otherwise."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from rasterizer.reference.blend import Thresholds

MACROS = {  # of rasterizer/src/numerical_choices.hpp
    "min_presence": "RASTERIZER_MIN_PRESENCE",
    "min_alpha": "RASTERIZER_MIN_ALPHA",
    "min_transmittance": "RASTERIZER_MIN_TRANSMITTANCE",
    "exp_degree": "RASTERIZER_EXP_DEGREE",
    "exact_culling": "RASTERIZER_EXACT_CULLING",
    "block_masks": "RASTERIZER_BLOCK_MASKS",
    "float64": "RASTERIZER_FLOAT64",
    "sh_type": "RASTERIZER_SH_TYPE",
}


@dataclass(frozen=True)
class Choices:
    """What numerical_choices.hpp names, with its values; `kernel.choices` says what a kernel was built with."""

    min_marginal: float = 0.05
    min_alpha: float = 1 / 255
    min_transmittance: float = 1e-4
    exp_degree: int = 4
    exact_culling: bool = True
    block_masks: bool = True
    float64: bool = False
    sh_type: str = "scalar"  # as everything else

    def definitions(self) -> list[str]:
        """MACRO=value of what differs from the kernel's own."""
        own = asdict(Choices())
        return [f"{MACROS[name]}={_in_cpp(value)}" for name, value in asdict(self).items() if value != own[name]]

    def thresholds(self) -> Thresholds:
        """The same cut-offs for the readable twin."""
        return Thresholds(self.min_marginal, self.min_alpha, self.min_transmittance)


def _in_cpp(value: float | str) -> str:
    return value if isinstance(value, str) else str(int(value)) if isinstance(value, bool) else repr(value)


@dataclass(frozen=True)
class Variant:
    """One point of the diagram."""

    name: str  # also of its extension module: letters, digits, _
    trade: str  # which trade-off it belongs to, in TRADES
    label: str
    choices: Choices = Choices()

    @property
    def is_built(self) -> bool:
        """Whether it is a kernel of its own, not the package's."""
        return self.name != DEFAULT


# A trade-off, and the twin's thresholds that its own error leaves standing: those that it sets are zero.
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
AGAIN = "again"  # the same choices in another module: what its time differs by says nothing of any choice


def _digits(value: float) -> str:
    return f"{value:g}".replace(".", "_").replace("-", "m")


def _row(trade: str, name: str, label: str, **choices: float | str) -> Variant:
    """The kernel as it is, where that is what the choices say."""
    made = Choices(**choices)
    return Variant(DEFAULT if made == Choices() else name, trade, label, made)


def _steps(trade: str, field: str, label: str, *values: float) -> list[Variant]:
    return [_row(trade, f"{field}_{_digits(value)}", label.format(f"{value:g}"), **{field: value}) for value in values]


def all_variants() -> list[Variant]:
    """Trade-off by trade-off, the kernel as it is among them in each, from coarse to fine."""
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
        *_steps("temporal cut-off", "min_presence", "p(t) >= {}", 0.2, 0.1, 0.05, 0.02, 0.01, 1e-3, 1e-4),
        *(
            _row("alpha cut-off", f"min_alpha_{label.replace('/', '_')}", f"α' >= {label}", min_alpha=value)
            for label, value in alphas
        ),
        *_steps("transmittance stop", "min_transmittance", "T >= {}", 1e-2, 1e-3, 1e-4, 1e-5, 1e-6),
        *_steps("exp degree", "exp_degree", "degree {}", 3, 4, 5),
        *(
            _row(
                "culling and masks", f"masks_{int(exact)}{int(blocks)}", label, exact_culling=exact, block_masks=blocks
            )
            for label, exact, blocks in masks
        ),
        *(_row("SH precision", f"sh_{name}", f"coefficients in {name}", sh_type=stored) for name, stored in precisions),
        _row("floating point", "float32", "float32"),
        _row("floating point", "float64", "float64", float64=True),
        *(
            _row(
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
