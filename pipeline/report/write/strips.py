"""Render | truth | difference strips from the images a run left in renders/.

For each scene and schedule: the median and the worst view of `full` (of the first model, where it has no run), then the
same median view of each other model, so that the eye compares like with like. The median is shown because it is what
the number stands for, the worst because a mean hides it.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from PIL import Image

from datasets.files.errors import clear
from pipeline.report.read import scenes
from pipeline.runs.read.names import file_name

PARTS = ("render", "truth", "difference")
_MAX_SIDE = 512  # a wider view is shrunk: the page must stay mailable
_GAP = 6  # pixels between the parts
_QUALITY = 90  # of 100: no loss the eye finds; the exact images stay in the run's renders/
DIFFERENCE_GAIN = 4  # pipeline/evaluation/evaluate.py writes |render - truth| so many times brighter


@dataclass(frozen=True)
class Strip:
    """One picture for the page; `webp` holds render, truth and difference side by side."""

    scene: str
    ablation: str
    train: str
    seed: int
    view: str
    why: str  # median | worst | shown: how the view was picked
    of: str  # the model whose median or worst view it is
    psnr: float | None  # of this view, dB
    webp: bytes

    @property
    def said(self) -> str:
        """How the view was picked, in words."""
        return self.why if self.of == self.ablation else f"{self.why} of {self.of}"

    @property
    def filename(self) -> str:
        """Unique among strips, safe in any file system."""
        return webp_name(self.scene, self.ablation, self.train, f"seed{self.seed}", self.why, self.view)


def _shown_schedules(trains: pd.Series) -> list[str]:
    names = sorted(trains.unique())
    return [name for name in names if "(" not in name] or names


def make_strips(runs: pd.DataFrame, no_pictures: tuple[str, ...] = ()) -> tuple[list[Strip], list[str]]:
    """Strips in the report's order, and one warning line for each image that could not be read.

    Schedules as they are, without the variants of them that a study compares in tables (name_variants puts what
    they changed in brackets), unless there are only those. no_pictures: scenes (dnerf/lego) or families (dnerf) that
    get none; a warning line says so.
    """
    strips: list[Strip] = []
    warnings: list[str] = []
    for scene in scenes.in_order(runs["scene"]):
        if kept_back(scene, no_pictures):
            warnings.append(f"{scene}: pictures left out, as asked (--no-pictures)")
            continue
        for train in _shown_schedules(runs[runs["scene"] == scene]["train"]):
            group = runs[(runs["scene"] == scene) & (runs["train"] == train)]
            chosen: list[tuple[str, str]] = []  # (why, view): fixed by the first run, so all show the same view
            names = scenes.ablations_in_order(group["ablation"])
            for name in names:
                row = group[group["ablation"] == name].sort_values("seed").iloc[0]
                folder = Path(row["folder"])
                psnr_of = _psnr_by_view(folder / "per_image.csv")
                chosen = chosen or choose_views(folder / "renders", psnr_of)
                for why, view in chosen if name == names[0] else chosen[:1]:
                    try:
                        webp = compose([folder / "renders" / f"{view}_{part}.png" for part in PARTS])
                    except Exception as error:  # PIL raises many types for broken files
                        warnings.append(f"{row['run']}: no strip of {clear(view)}: {clear(error)}")
                        continue
                    strips.append(
                        Strip(scene, name, train, int(row["seed"]), view, why, names[0], psnr_of.get(view), webp)
                    )
    return strips, warnings


def webp_name(*words: str) -> str:
    """A file's name of the words, safe in any file system."""
    return file_name("".join(c if c.isalnum() or c in "-_." else "_" for c in "__".join(words))) + ".webp"


def kept_back(scene: str, no_pictures: tuple[str, ...]) -> bool:
    """Is the scene or its family among those whose pictures may not be passed on?"""
    return scene in no_pictures or scene.split("/")[0] in no_pictures


def choose_views(renders: Path, psnr_of: dict[str, float]) -> list[tuple[str, str]]:
    """(why, view): median and worst by PSNR; without PSNRs the middle one by name; [] without images."""
    views = sorted(p.name.removesuffix("_render.png") for p in renders.glob("*_render.png"))
    known = sorted((psnr_of[v], v) for v in views if v in psnr_of)
    if not known:
        return [("shown", views[len(views) // 2])] if views else []
    median, worst = known[len(known) // 2][1], known[0][1]
    return [("median", median)] + ([("worst", worst)] if worst != median else [])


def compose(paths: list[Path], max_side: int = _MAX_SIDE) -> bytes:
    """The images side by side as WebP, gaps transparent; one larger than `max_side` pixels is shrunk."""
    images = []
    for path in paths:
        with Image.open(path) as image:
            images.append(image.convert("RGB"))
    scale = min(1.0, max_side / max(images[0].size))
    size = (max(1, round(images[0].width * scale)), max(1, round(images[0].height * scale)))
    strip = Image.new("RGBA", (len(images) * size[0] + (len(images) - 1) * _GAP, size[1]), (0, 0, 0, 0))
    for i, image in enumerate(images):
        strip.paste(
            image if image.size == size else image.resize(size, Image.Resampling.LANCZOS), (i * (size[0] + _GAP), 0)
        )
    buffer = io.BytesIO()
    strip.save(buffer, "WEBP", quality=_QUALITY)
    return buffer.getvalue()


def _psnr_by_view(path: Path) -> dict[str, float]:
    """per_image.csv: view (/ as _, as in file names) -> PSNR of the final model; {} if it can't be read."""
    try:
        table = pd.read_csv(path)
    except (OSError, ValueError, OverflowError):
        return {}
    if not {"view", "psnr"} <= set(table):
        return {}
    if "model" in table:
        table = table[table["model"] == "final"]
    return {
        str(view).replace("/", "_"): float(psnr)
        for view, psnr in zip(table["view"], pd.to_numeric(table["psnr"], errors="coerce"))
        if psnr == psnr
    }
