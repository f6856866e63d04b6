"""Labels the model that a run trained: `full`, `no_4dsh`, `full, 4DSH left out`, `full (fourier_order=1)`.

The trained model can differ from the requested ablation. Selection by validation may leave out time-varying colour
(the Fourier orders of 4DSH), and a command may change keys of `ablation`. The label states both. A clip that validation
found static is labelled `static`, as its model is that of the ablation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

from pipeline.config.schema import AblationConfig
from pipeline.runs.read.run_names import parts_of, with_parts
from pipeline.runs.run_identity import read_config

STATIC = "static"  # conf/ablation/static.yaml
LEFT_OUT = ", 4DSH left out"
LEFT_OUT_NOTE = ("", "4DSH left out: the run requested time-varying colour, and selection by validation removed it.")
_ABLATIONS = Path(__file__).resolve().parents[3] / "conf" / "ablation"
_TIME_KEYS = ("rotation_4d", "fourier_order", "time_split", "add_by_error")  # without effect in a static model


@dataclass(frozen=True)
class TrainedModel:
    """The `ablation` settings of a trained model, without the keys that have no effect in it."""

    settings: dict[str, Any]
    left_out: bool  # selection by validation removed time-varying colour; `fourier_order` is then not in settings


def requested(label: str) -> str:
    """The label of the model that the run requested, whatever selection by validation removed."""
    return label.replace(LEFT_OUT, "", 1)


def is_left_out(label: str) -> bool:
    """Whether selection by validation removed time-varying colour."""
    return LEFT_OUT in label


def ablation_of(label: str) -> str:
    """`no_4drot` of `no_4drot, 4DSH left out (sh_degree=2)`."""
    return parts_of(requested(label))[0]


def baseline_of(label: str) -> str | None:
    """The label of the model that this model is compared with; None for `full` itself.

    The two differ only in the ablated part: `no_4drot, 4DSH left out` is compared with `full, 4DSH left out`,
    `no_4drot (sh_degree=2)` with `full (sh_degree=2)`, and `full (sh_degree=2)` with `full`.
    """
    parts, left_out = parts_of(label)[1], LEFT_OUT if is_left_out(label) else ""
    if ablation_of(label) == "full":
        return f"full{left_out}" if parts else None
    return with_parts(f"full{left_out}", parts)


@cache
def settings_of(ablation: str) -> Mapping[str, Any] | None:
    """The settings in conf/ablation/`ablation`.yaml without `name`; None where there is no such file."""
    path = _ABLATIONS / f"{ablation}.yaml"
    if path not in _ABLATIONS.glob("*.yaml"):  # the name comes from a run's files and may be any text
        return None
    settings = asdict(AblationConfig()) | read_config(path)
    return {key: value for key, value in settings.items() if key != "name"}


def trained_model(ablation: str, settings: Mapping[str, Any], run: Mapping[str, Any]) -> TrainedModel:
    """The trained model as the run's files record it; where they do not, the requested one.

    settings: of the whole run, flattened to dotted keys. run: its row of Collection.runs.
    """
    found = {key.removeprefix("ablation."): value for key, value in settings.items() if key.startswith("ablation.")}
    found.pop("name", None)
    motion, order, degree = run["model.motion"], run["model.fourier_order"], run["model.sh_degree"]
    if not math.isnan(degree):
        found["sh_degree"] = int(degree)
    if run["found_static"]:
        found["static"] = True
    if motion == "static":
        return TrainedModel({key: value for key, value in found.items() if key not in _TIME_KEYS}, False)
    if motion:
        found["rotation_4d"] = motion == "full"
    if math.isnan(order):
        return TrainedModel(found, False)
    requested_order = found.pop("fourier_order", (settings_of(ablation) or {}).get("fourier_order", 0))
    if order == 0 and requested_order != 0:
        return TrainedModel(found, True)
    return TrainedModel(found | {"fourier_order": int(order)}, False)
