"""Which model a run trained, in words: `full`, `no_4dsh`, `full, 4DSH left out`, `full (fourier_order=1)`.

A run asks for a model by the name of an ablation, but need not train that one. The schedule may select by validation
and leave time-varying colour, the Fourier orders of 4DSH, out; and a command may change keys of
`ablation`. Both are part of the name here, so that no model passes for another.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

from pipeline.config.schema import AblationConfig
from pipeline.runs.read.names import parts_of, with_parts
from pipeline.runs.run_identity import read_config

LEFT_OUT = ", 4DSH left out"
LEFT_OUT_NOTE = (
    "",
    "4DSH left out: selection by validation left time-varying colour out of these models, though the run asked for it.",
)
_ABLATIONS = Path(__file__).resolve().parents[3] / "conf" / "ablation"
_OF_TIME = ("rotation_4d", "fourier_order", "time_split")  # mean nothing where a model has no time


@dataclass(frozen=True)
class Trained:
    """A trained model as settings of `ablation`, without those that mean nothing in it."""

    settings: dict[str, Any]
    left_out: bool  # selection by validation left time-varying colour out; then `fourier_order` is none of them


def asked(label: str) -> str:
    """What the run asked for: the label without what selection left out."""
    return label.replace(LEFT_OUT, "", 1)


def is_left_out(label: str) -> bool:
    """Did selection by validation leave time-varying colour out?"""
    return LEFT_OUT in label


def ablation_of(label: str) -> str:
    """`no_4drot` of `no_4drot, 4DSH left out (sh_degree=2)`."""
    return parts_of(asked(label))[0]


def reference(label: str) -> str | None:
    """The label of the model that this one is compared with: whole but for what the ablation removes.

    Like with like: `no_4drot, 4DSH left out` is compared with `full, 4DSH left out`, `no_4drot (sh_degree=2)` with
    `full (sh_degree=2)`; and what was changed of `full` with `full`. None for `full` itself.
    """
    parts, left_out = parts_of(label)[1], LEFT_OUT if is_left_out(label) else ""
    if ablation_of(label) == "full":
        return f"full{left_out}" if parts else None
    return with_parts(f"full{left_out}", parts)


@cache
def settings_of(ablation: str) -> Mapping[str, Any] | None:
    """The settings that conf/ablation gives this name, `name` not among them; None for a name it does not have."""
    path = _ABLATIONS / f"{ablation}.yaml"
    if path not in _ABLATIONS.glob("*.yaml"):  # a name from a run's files may be anything
        return None
    found = asdict(AblationConfig()) | read_config(path)
    return {key: value for key, value in found.items() if key != "name"}


def trained(ablation: str, settings: Mapping[str, Any], run: Mapping[str, Any]) -> Trained:
    """The model that a run trained, as far as its files say; for the rest, what it asked for.

    settings: of the whole run, flattened. run: its row of Collection.runs.
    """
    found = {key.removeprefix("ablation."): value for key, value in settings.items() if key.startswith("ablation.")}
    found.pop("name", None)
    motion, order, degree = run["model.motion"], run["model.fourier_order"], run["model.sh_degree"]
    if not math.isnan(degree):
        found["sh_degree"] = int(degree)
    if motion == "static":
        return Trained({key: value for key, value in found.items() if key not in _OF_TIME}, False)
    if motion:
        found["rotation_4d"] = motion == "full"
    if math.isnan(order):
        return Trained(found, False)
    asked_order = found.pop("fourier_order", (settings_of(ablation) or {}).get("fourier_order", 0))
    if order == 0 and asked_order != 0:
        return Trained(found, True)
    return Trained(found | {"fourier_order": int(order)}, False)
