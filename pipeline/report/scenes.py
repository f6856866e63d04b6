"""Which scene belongs to which table, and which ablation each synthetic scene was made for."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from types import MappingProxyType

# The paper's order of columns (its per-scene table).
PLENOPTIC = tuple(
    f"plenoptic/{name}"
    for name in (
        "coffee_martini",
        "cook_spinach",
        "cut_roasted_beef",
        "flame_salmon",
        "flame_steak",
        "sear_steak",
    )
)

# Table 2 is the mean over these eight.
DNERF = tuple(
    f"dnerf/{name}"
    for name in ("bouncingballs", "hellwarrior", "hook", "jumpingjacks", "lego", "mutant", "standup", "trex")
)

# Table 3 ablates on these two.
TABLE3 = ("plenoptic/flame_salmon", "plenoptic/cut_roasted_beef")

ABLATIONS = ("no_4drot", "no_4dsh", "no_time_split", "full")  # the paper's order of rows


@dataclass(frozen=True)
class MadeFor:
    """An ablation, the synthetic scene that needs the part it removes, and why."""

    ablation: str
    scene: str
    reason: str


MADE_FOR = (
    MadeFor(
        "no_4drot",
        "synthetic/wheel",
        "fast rotation and translation: without 4D rotation a Gaussian can't move",
    ),
    MadeFor(
        "no_4dsh",
        "synthetic/lamp",
        "colours that change with time and view: without Fourier orders they can't",
    ),
    MadeFor(
        "no_time_split",
        "synthetic/burst",
        "things appear, move off and vanish: a split in space alone moves no Gaussian in time",
    ),
)
MADE_FOR_SCENE = MappingProxyType({(m.scene, m.ablation): m for m in MADE_FOR})


def family(scene: str) -> str:
    """`plenoptic`, `dnerf` or `synthetic` for the scenes of the paper's tables and ours, else `other`."""
    if scene in PLENOPTIC:
        return "plenoptic"
    if scene in DNERF:
        return "dnerf"
    return "synthetic" if scene.startswith("synthetic/") else "other"


def in_order(names: Iterable[str]) -> list[str]:
    """Scenes without repeats, synthetic first (`still`, which needs no part, last), then the real ones."""
    first = (*(made.scene for made in MADE_FOR), "synthetic/still", *DNERF, *PLENOPTIC)
    unique = set(names)
    return [name for name in first if name in unique] + sorted(unique - set(first))


def ablations_in_order(names: Iterable[str]) -> list[str]:
    """Ablations without repeats: `full` first, the paper's, then any other."""
    first = ("full", *ABLATIONS[:3])
    unique = set(names)
    return [name for name in first if name in unique] + sorted(unique - set(first))


def short(scene: str) -> str:
    """`dnerf/lego` -> `lego`."""
    return scene.rsplit("/", 1)[-1]
