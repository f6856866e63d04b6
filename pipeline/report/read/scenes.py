"""Scenes of the paper's tables, families of scenes, and the ablation that each synthetic scene was made for."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from types import MappingProxyType

from pipeline.runs.read import model_labels as models

# In the column order of the paper's per-scene table.
PLENOPTIC = tuple(
    f"plenoptic/{name}"
    for name in ("coffee_martini", "cook_spinach", "cut_roasted_beef", "flame_salmon", "flame_steak", "sear_steak")
)

# The eight scenes of Table 2.
DNERF = tuple(
    f"dnerf/{name}"
    for name in ("bouncingballs", "hellwarrior", "hook", "jumpingjacks", "lego", "mutant", "standup", "trex")
)

# The two scenes of the ablations in Table 3.
TABLE3 = ("plenoptic/flame_salmon", "plenoptic/cut_roasted_beef")

FAMILIES = (
    "synthetic",
    "dnerf",
    "plenoptic",
    "dnerf_own",
    "plenoptic_own",
    "video_own",
    "urban",
    "other",
)  # in the order of the report

ABLATIONS = ("no_4drot", "no_4dsh", "no_time_split", "full")  # in the row order of Table 3


@dataclass(frozen=True)
class MadeFor:
    """An ablation, the synthetic scene that needs the ablated part, and the reason."""

    ablation: str
    scene: str
    reason: str


MADE_FOR = (
    MadeFor("no_4drot", "synthetic/wheel", "fast motion; without 4D rotation a Gaussian has no velocity"),
    MadeFor(
        "no_4dsh",
        "synthetic/lamp",
        "colours change with time and view; without Fourier orders they are constant in time",
    ),
    MadeFor(
        "no_time_split",
        "synthetic/burst",
        "objects appear and vanish; a split in space alone leaves the temporal means unchanged; ours also adds no "
        "Gaussians by error (ablation.add_by_error=true keeps that)",
    ),
)
MADE_FOR_SCENE = MappingProxyType({(m.scene, m.ablation): m for m in MADE_FOR})


def family(scene: str) -> str:
    """The family of a scene, one of FAMILIES: one table of scenes per family.

    `dnerf` and `plenoptic` are the paper's scenes only; `dnerf_own`, ... are other scenes in the same layout.
    """
    if scene in PLENOPTIC:
        return "plenoptic"
    if scene in DNERF:
        return "dnerf"
    kind = scene.split("/")[0]
    if kind == "synthetic":
        return "synthetic"
    if kind in ("kitti", "waymo"):
        return "urban"
    return f"{kind}_own" if f"{kind}_own" in FAMILIES else "other"


def in_order(names: Iterable[str]) -> list[str]:
    """Unique scenes in the order of the report: synthetic, D-NeRF, Plenoptic Video, others."""
    first = (*(made.scene for made in MADE_FOR), "synthetic/still", *DNERF, *PLENOPTIC)
    unique = set(names)
    return [name for name in first if name in unique] + sorted(unique - set(first))


def ablations_in_order(names: Iterable[str]) -> list[str]:
    """Unique model labels in the order of the report: `full` and its variants, the paper's ablations, others."""
    first = ("full", *ABLATIONS[:3])

    def place(name: str) -> tuple[int, str]:
        ablation = models.ablation_of(name)
        return first.index(ablation) if ablation in first else len(first), name

    return sorted(set(names), key=place)


def short(scene: str) -> str:
    """`dnerf/lego` -> `lego`."""
    return scene.rsplit("/", 1)[-1]
