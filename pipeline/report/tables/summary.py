"""What the report says first: how good, which ablations hold, what is missing, where it ran."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from pipeline.presentation.seeds import Verdict, over_seeds, trains, verdict
from pipeline.presentation.table import measured
from pipeline.report.read import scenes
from pipeline.report.read.measured_on import on_papers_views
from pipeline.report.tables.our_rows import left_out_notes
from pipeline.report.tables.verdicts import made_for_labels
from pipeline.runs.read.collect import Collection
from pipeline.runs.read.model_labels import asked, reference

_COMMIT = 10  # characters of a commit's hash; the whole of it stands beside each run


@dataclass(frozen=True)
class Headline:
    """A model of one scene under one schedule; texts are ready to print, mean ± std over seeds."""

    scene: str
    train: str
    model: str  # `full`, `full, 4DSH left out`; another only where the scene has no such run
    psnr: str  # final, dB
    best: str  # best on test, dB
    seconds: str  # training time
    seeds: int

    @property
    def name(self) -> str:
        """Schedule and, unless that is full, model."""
        return self.train if self.model == "full" else f"{self.train}, {self.model}"


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
    remarks: tuple[str, ...]  # of how many scenes the paper's tables have a mean, what a model's name means
    left_out: tuple[str, ...]
    warnings: tuple[str, ...]
    machines: tuple[str, ...]
    dates: str
    commits: tuple[str, ...]


def summarise(collection: Collection, strip_warnings: Sequence[str] = ()) -> Summary:
    """Reads nothing but the collection."""
    runs = collection.runs
    dates = sorted(d[:10] for d in runs["date"] if d != "unknown")
    headlines = tuple(h for scene in scenes.in_order(runs["scene"]) for h in _headlines(runs, scene))
    return Summary(
        runs=len(runs),
        headlines=headlines,
        holdings=tuple(h for made in scenes.MADE_FOR for h in _holdings(runs, made)),
        remarks=(
            *_remarks(on_papers_views(collection)),
            *(text for _, text in left_out_notes(h.model for h in headlines)),
        ),
        left_out=collection.left_out,
        warnings=(*collection.warnings, *strip_warnings),
        machines=tuple(sorted(set(runs["machine"]))),
        commits=tuple(sorted({_shortened(commit) for commit in runs["git_commit"]})),
        dates=" to ".join(dict.fromkeys((dates[0], dates[-1]))) if dates else "unknown",
    )


def _shortened(commit: str) -> str:
    """A hash to its first characters; what follows it (-dirty) stays."""
    return re.sub(rf"^([0-9a-f]{{{_COMMIT}}})[0-9a-f]*", r"\1", commit)


def summary_markdown(summary: Summary) -> str:
    """The first screen of report.md."""
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
    lines += [f"- {h.ablation} on {h.scene}: {h.sentence}" for h in summary.holdings]
    lines += [f"- {line}" for line in (*summary.remarks, *summary.left_out, *summary.warnings)]
    return "\n".join(lines) + "\n"


def _headlines(runs: pd.DataFrame, scene: str) -> list[Headline]:
    """A line each of the scene's schedules and models that were to be full; of all its models if none was."""
    mine = runs[runs["scene"] == scene]
    whole = mine[mine["ablation"].map(asked) == "full"]
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
        for (train, model), seeds in (mine if whole.empty else whole).groupby(["train", "ablation"], sort=True)
    ]


def _holdings(runs: pd.DataFrame, made: scenes.MadeFor) -> list[Holding]:
    """What there is to compare."""
    return [
        _holding(result, made.scene, label, train)
        for train in trains(runs, [made.scene])
        for label in made_for_labels(runs, made, train)
        if (result := verdict(runs, made.scene, label, train, "final.psnr")) is not None
    ]


def _holding(result: Verdict, scene: str, label: str, train: str) -> Holding:
    whole, by = reference(label), f"full − ablation = {result.difference:.2f} dB"
    if result.word == "too few seeds":
        return Holding(label, scene, f"{by}; too few seeds for a verdict ({train})", "open")
    rule = f"2 SE = {2 * result.standard_error:.2f} dB"
    sentence = {
        "worse": f"worse than {whole}: {by}, {rule} ({train})",
        "better": f"NOT worse than {whole} but better: {by}, {rule} ({train})",
        "no difference shown": f"NOT shown to be worse than {whole}: {by}, {rule} ({train})",
    }[result.word]
    return Holding(label, scene, sentence, "good" if result.word == "worse" else "bad")


def _remarks(runs: pd.DataFrame) -> list[str]:
    """Of how many of their scenes the paper's tables that have a run have one."""
    lines = []
    for title, wanted in (("Table 1 (Plenoptic Video)", scenes.PLENOPTIC), ("Table 2 (D-NeRF)", scenes.DNERF)):
        have = runs[runs["scene"].isin(wanted) & (runs["ablation"].map(asked) == "full")]["scene"].nunique()
        if 0 < have < len(wanted):
            lines.append(f"{title}: {have} of {len(wanted)} scenes have a run of full; the mean is over those.")
    return lines
