"""What the report says first: how good, which ablations hold, what is missing, where it ran."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from . import scenes
from .aggregate import over_seeds, select, trains, verdict
from .collect import Collection
from .table import measured


@dataclass(frozen=True)
class Headline:
    """`full` on one scene under one schedule; texts are ready to print, mean ± std over seeds."""

    scene: str
    train: str
    psnr: str  # final, dB
    best: str  # best on test, dB
    seconds: str  # training time
    seeds: int


@dataclass(frozen=True)
class Holding:
    """One ablation on the scene made for it; `state` is good, bad or open (for the badge)."""

    ablation: str
    scene: str
    sentence: str
    state: str


@dataclass(frozen=True)
class Summary:
    """The first screen."""

    runs: int
    headlines: tuple[Headline, ...]
    holdings: tuple[Holding, ...]
    missing: tuple[str, ...]  # what the paper's tables still lack
    left_out: tuple[str, ...]
    warnings: tuple[str, ...]
    machines: tuple[str, ...]
    dates: str
    commits: tuple[str, ...]


def summarise(collection: Collection, strip_warnings: Sequence[str] = ()) -> Summary:
    """Reads nothing but the collection."""
    runs = collection.runs
    dates = sorted(d[:10] for d in runs["date"] if d != "unknown")
    return Summary(
        runs=len(runs),
        headlines=tuple(
            _headline(runs, scene, train)
            for scene in scenes.in_order(runs["scene"])
            for train in trains(runs, [scene], "full")
        ),
        holdings=tuple(h for made in scenes.MADE_FOR for h in _holdings(runs, made)),
        missing=_missing(runs),
        left_out=collection.left_out,
        warnings=(*collection.warnings, *strip_warnings),
        machines=tuple(sorted(set(runs["machine"]))),
        commits=tuple(sorted(set(runs["git_commit"]))),
        dates=" to ".join(dict.fromkeys((dates[0], dates[-1]))) if dates else "unknown",
    )


def summary_markdown(summary: Summary) -> str:
    """The first screen of report.md."""
    lines = [
        f"{summary.runs} runs; dates: {summary.dates}; machine: {'; '.join(summary.machines)}; "
        f"commit: {', '.join(summary.commits)}.",
        "",
    ]
    lines += [
        f"- **{h.scene}**, {h.train}: {h.psnr} dB final, {h.best} dB best on test, {h.seconds} s training, "
        f"{h.seeds} seed{'s' if h.seeds != 1 else ''}"
        for h in summary.headlines
    ]
    lines += [f"- {h.ablation} on {h.scene}: {h.sentence}" for h in summary.holdings]
    lines += [f"- {line}" for line in (*summary.missing, *summary.left_out, *summary.warnings)]
    return "\n".join(lines) + "\n"


def _headline(runs: pd.DataFrame, scene: str, train: str) -> Headline:
    return Headline(
        scene,
        train,
        measured(over_seeds(runs, scene, "full", train, "final.psnr")).text,
        measured(over_seeds(runs, scene, "full", train, "best_on_test.psnr")).text,
        measured(over_seeds(runs, scene, "full", train, "train_seconds"), 0).text,
        len(select(runs, scene, "full", train)),
    )


def _holdings(runs: pd.DataFrame, made: scenes.MadeFor) -> list[Holding]:
    found = []
    for train in trains(runs, [made.scene]):
        result = verdict(runs, made.scene, made.ablation, train, "final.psnr")
        if result is None:
            continue
        by = f"full − ablation = {result.difference:.2f} dB"
        if result.word == "too few seeds":
            state, sentence = "open", f"{by}; too few seeds for a verdict ({train})"
        else:
            state = "good" if result.word == "worse" else "bad"
            rule = f"2 SE = {2 * result.standard_error:.2f} dB"
            sentence = {
                "worse": f"worse than full: {by}, {rule} ({train})",
                "better": f"NOT worse than full but better: {by}, {rule} ({train})",
                "no difference shown": f"NOT shown to be worse than full: {by}, {rule} ({train})",
            }[result.word]
        found.append(Holding(made.ablation, made.scene, sentence, state))
    return found or [Holding(made.ablation, made.scene, "no runs to compare", "open")]


def _missing(runs: pd.DataFrame) -> tuple[str, ...]:
    lines = []
    for title, wanted in (
        ("Table 1 (Plenoptic Video)", scenes.PLENOPTIC),
        ("Table 2 (D-NeRF)", scenes.DNERF),
    ):
        have = runs[runs["scene"].isin(wanted) & (runs["ablation"] == "full")]["scene"].nunique()
        if have < len(wanted):
            lines.append(
                f"{title}: {f'{have} of {len(wanted)} scenes have' if have else 'no scene has'} a run of "
                f"full; {'the mean is over those' if have else 'our cells are empty'}."
            )
    have = runs[runs["scene"].isin(scenes.TABLE3)]
    if not all(
        ((have["scene"] == s) & (have["ablation"] == a)).any()
        for s in scenes.TABLE3
        for a in scenes.ABLATIONS
    ):
        lines.append("Table 3 (ablations on Plenoptic Video): cells without a run are empty.")
    return tuple(lines)
