"""Which scene belongs to which table, and which ablation each synthetic scene was made for."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from types import MappingProxyType

from pipeline.runs.read import model_labels as models

# The paper's order of columns (its per-scene table).
PLENOPTIC = tuple(
    f"plenoptic/{name}"
    for name in ("coffee_martini", "cook_spinach", "cut_roasted_beef", "flame_salmon", "flame_steak", "sear_steak")
)

# Table 2 is the mean over these eight.
DNERF = tuple(
    f"dnerf/{name}"
    for name in ("bouncingballs", "hellwarrior", "hook", "jumpingjacks", "lego", "mutant", "standup", "trex")
)

# Table 3 ablates on these two.
TABLE3 = ("plenoptic/flame_salmon", "plenoptic/cut_roasted_beef")

FAMILIES = ("synthetic", "dnerf", "plenoptic", "dnerf_own", "plenoptic_own", "video_own", "other")  # in reading order

ABLATIONS = ("no_4drot", "no_4dsh", "no_time_split", "full")  # the paper's order of rows


@dataclass(frozen=True)
class MadeFor:
    """An ablation, the synthetic scene that needs the part it removes, and why."""

    ablation: str
    scene: str
    reason: str


MADE_FOR = (
    MadeFor("no_4drot", "synthetic/wheel", "fast rotation and translation: without 4D rotation a Gaussian can't move"),
    MadeFor("no_4dsh", "synthetic/lamp", "colours that change with time and view: without Fourier orders they can't"),
    MadeFor(
        "no_time_split",
        "synthetic/burst",
        "things appear, move off and vanish: a split in space alone moves no Gaussian in time",
    ),
)
MADE_FOR_SCENE = MappingProxyType({(m.scene, m.ablation): m for m in MADE_FOR})


def family(scene: str) -> str:
    """Which table of scenes a scene stands in: one of FAMILIES.

    `dnerf` and `plenoptic` are the paper's scenes alone, `dnerf_own` and so on are others of that layout.
    """
    if scene in PLENOPTIC:
        return "plenoptic"
    if scene in DNERF:
        return "dnerf"
    kind = scene.split("/")[0]
    if kind == "synthetic":
        return "synthetic"
    return f"{kind}_own" if f"{kind}_own" in FAMILIES else "other"


def in_order(names: Iterable[str]) -> list[str]:
    """Scenes without repeats, synthetic first (`still`, which needs no part, last), then the real ones."""
    first = (*(made.scene for made in MADE_FOR), "synthetic/still", *DNERF, *PLENOPTIC)
    unique = set(names)
    return [name for name in first if name in unique] + sorted(unique - set(first))


def ablations_in_order(names: Iterable[str]) -> list[str]:
    """Models without repeats: `full` and what was made of it first, the paper's ablations, then any other."""
    first = ("full", *ABLATIONS[:3])

    def place(name: str) -> tuple[int, str]:
        ablation = models.ablation_of(name)
        return first.index(ablation) if ablation in first else len(first), name

    return sorted(set(names), key=place)


def short(scene: str) -> str:
    """`dnerf/lego` -> `lego`."""
    return scene.rsplit("/", 1)[-1]
