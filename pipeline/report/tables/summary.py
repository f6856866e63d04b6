"""The summary at the top of the report: results per scene, ablation verdicts, missing runs, provenance."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from pipeline.presentation.seed_statistics import TOO_FEW_SEEDS, Verdict, over_seeds, trains, verdict
from pipeline.presentation.table import measured
from pipeline.report.read import scenes
from pipeline.report.read.evaluation_split import on_paper_split
from pipeline.report.tables.ablation_verdicts import made_for_labels
from pipeline.report.tables.footnotes import left_out_notes
from pipeline.runs.read.collect import Collection
from pipeline.runs.read.model_labels import baseline_of, requested

_COMMIT = 10  # characters of a commit hash; the table of provenance has all


@dataclass(frozen=True)
class Headline:
    """The result of a scene, schedule and model, as text: mean ± std over seeds."""

    scene: str
    train: str
    model: str  # `full` or `full, 4DSH left out`; others only where the scene has no such run
    psnr: str  # final, dB
    best: str  # best on test, dB
    seconds: str  # training time
    seeds: int

    @property
    def name(self) -> str:
        """The schedule, and the model unless that is full."""
        return self.train if self.model == "full" else f"{self.train}, {self.model}"


@dataclass(frozen=True)
class AblationResult:
    """One ablation on the scene made for it. `word` is that of its Verdict."""

    ablation: str
    scene: str
    word: str
    detail: str


@dataclass(frozen=True)
class Summary:
    """The contents of the summary."""

    runs: int
    headlines: tuple[Headline, ...]
    ablations: tuple[AblationResult, ...]
    remarks: tuple[str, ...]  # scenes missing from the paper's means; meaning of model labels
    left_out: tuple[str, ...]
    warnings: tuple[str, ...]
    machines: tuple[str, ...]
    dates: str
    commits: tuple[str, ...]


def summarise(collection: Collection, more_warnings: Sequence[str] = ()) -> Summary:
    """The summary of a collection. more_warnings: from reading images."""
    runs = collection.runs
    dates = sorted(d[:10] for d in runs["date"] if d != "unknown")
    headlines = tuple(h for scene in scenes.in_order(runs["scene"]) for h in _headlines(runs, scene))
    return Summary(
        runs=len(runs),
        headlines=headlines,
        ablations=tuple(result for made in scenes.MADE_FOR for result in _ablation_results(runs, made)),
        remarks=(
            *_remarks(on_paper_split(collection)),
            *(text for _, text in left_out_notes(h.model for h in headlines)),
        ),
        left_out=collection.left_out,
        warnings=(*collection.warnings, *more_warnings),
        machines=tuple(sorted(set(runs["machine"]))),
        commits=tuple(sorted({_shortened(commit) for commit in runs["git_commit"]})),
        dates=" to ".join(dict.fromkeys((dates[0], dates[-1]))) if dates else "unknown",
    )


def _shortened(commit: str) -> str:
    """A commit hash cut to _COMMIT characters; a suffix (-dirty) is kept."""
    return re.sub(rf"^([0-9a-f]{{{_COMMIT}}})[0-9a-f]*", r"\1", commit)


def summary_markdown(summary: Summary) -> str:
    """The summary as Markdown."""
    lines = [
        f"{summary.runs} run{'s' if summary.runs != 1 else ''}; dates: {summary.dates}; "
        f"machine: {'; '.join(summary.machines)}; commit: {', '.join(summary.commits)}.",
        "",
    ]
    lines += [
        f"- **{h.scene}**, {h.name}: {h.psnr} dB final, {h.best} dB best on test, {h.seconds} s training, "
        f"{h.seeds} seed{'s' if h.seeds != 1 else ''}"
        for h in summary.headlines
    ]
    lines += [f"- {a.ablation} on {a.scene}: {a.word}, {a.detail}" for a in summary.ablations]
    lines += [f"- {line}" for line in (*summary.remarks, *summary.left_out, *summary.warnings)]
    return "\n".join(lines) + "\n"


def _headlines(runs: pd.DataFrame, scene: str) -> list[Headline]:
    """One result per schedule and model requested as `full`; for a scene without such runs, per schedule and model."""
    of_scene = runs[runs["scene"] == scene]
    full = of_scene[of_scene["ablation"].map(requested) == "full"]
    return [
        Headline(
            scene,
            train,
            model,
            measured(over_seeds(runs, scene, model, train, "final.psnr")).text,
            measured(over_seeds(runs, scene, model, train, "best_on_test.psnr")).text,
            measured(over_seeds(runs, scene, model, train, "train_seconds"), 0).text,
            len(seeds),
        )
        for (train, model), seeds in (of_scene if full.empty else full).groupby(["train", "ablation"], sort=True)
    ]


def _ablation_results(runs: pd.DataFrame, made: scenes.MadeFor) -> list[AblationResult]:
    """Every schedule and model with runs of both the ablation and its baseline."""
    return [
        AblationResult(label, made.scene, result.word, _detail(result, label, train))
        for train in trains(runs, [made.scene])
        for label in made_for_labels(runs, made, train)
        if (result := verdict(runs, made.scene, label, train, "final.psnr")) is not None
    ]


def _detail(result: Verdict, label: str, train: str) -> str:
    detail = f"{baseline_of(label)} − ablation = {result.difference:.2f} dB"
    if result.word != TOO_FEW_SEEDS:
        detail += f", 2 SE = {2 * result.standard_error:.2f} dB"
    return f"{detail} ({train})"


def _remarks(runs: pd.DataFrame) -> list[str]:
    """How many scenes the means of the paper's tables cover, where some are missing."""
    lines = []
    for title, wanted in (("Table 1 (Plenoptic Video)", scenes.PLENOPTIC), ("Table 2 (D-NeRF)", scenes.DNERF)):
        have = runs[runs["scene"].isin(wanted) & (runs["ablation"].map(requested) == "full")]["scene"].nunique()
        if 0 < have < len(wanted):
            lines.append(f"{title}: {have} of {len(wanted)} scenes have a run of full; the mean is over these.")
    return lines
