"""Image strips, render | truth | difference, and for driving logs depth, from the images in a run's renders/ folder.

Per scene one schedule: the one with the best mean final PSNR of `full`. Shown are the median and the worst view of
`full` and, where it is known what moves, the view in which most does, as in moving_picture.py; of the ablation that
the scene was made for the same median view, and that of motion. Other models are compared in tables.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from PIL import Image

from datasets.files.errors import clear
from pipeline.presentation.seed_statistics import select
from pipeline.report.read import scenes
from pipeline.report.write.moving_picture import PARTS as MOVING_PARTS
from pipeline.report.write.moving_picture import moving_count, moving_parts
from pipeline.runs.read.model_labels import ablation_of, baseline_of, requested
from pipeline.runs.read.run_files import read_view_psnr
from pipeline.runs.read.run_names import file_name, parts_of

PARTS = ("render", "truth", "difference")
DEPTH = "rendered_depth"  # a fourth part, of driving logs
MOTION = "most motion"  # the choice of a view
_MAX_SIDE = 512  # pixels of a view, to limit the size of the page
_GAP = 6  # pixels between the parts
_QUALITY = 90  # of WebP; the exact images are in the run's renders/
DIFFERENCE_GAIN = 4  # of the difference images that pipeline/evaluation/pictures/view_pictures.py writes


@dataclass(frozen=True)
class Strip:
    """One view of one run; `webp` has the pictures of `parts` side by side."""

    scene: str
    ablation: str
    train: str
    seed: int
    view: str
    choice: str  # median | worst | example | MOTION: how the view was chosen
    chosen_for: str  # the model by whose PSNR it was chosen
    psnr: float | None  # of this view, dB
    webp: bytes
    viewer: Path | None = None  # the run's viewer.html
    with_depth: bool = False

    @property
    def choice_text(self) -> str:
        """How the view was chosen, such as `median of full`."""
        same = self.chosen_for == self.ablation or self.choice == MOTION
        return self.choice if same else f"{self.choice} of {self.chosen_for}"

    @property
    def parts(self) -> tuple[str, ...]:
        """What is side by side."""
        if self.choice == MOTION:
            return MOVING_PARTS
        return ("render", "truth", f"difference × {DIFFERENCE_GAIN}", *(("depth",) if self.with_depth else ()))

    @property
    def filename(self) -> str:
        """Unique among strips and valid in any file system."""
        return webp_name(self.scene, self.ablation, self.train, f"seed{self.seed}", self.choice, self.view)


def make_strips(runs: pd.DataFrame, no_pictures: tuple[str, ...] = ()) -> tuple[list[Strip], list[str]]:
    """Strips in the order of the report, and a warning for each image that could not be read.

    no_pictures: scenes (dnerf/lego) or families (dnerf) without strips; a warning names them.
    """
    strips: list[Strip] = []
    warnings: list[str] = []
    for scene in scenes.in_order(runs["scene"]):
        if is_excluded(scene, no_pictures):
            warnings.append(f"{scene}: no pictures, as requested by --no-pictures")
            continue
        train, model = shown_experiment(runs[runs["scene"] == scene])
        first = _first_seed(runs, scene, model, train)
        views = choose_views(first["folder"] / "renders", read_view_psnr(first["folder"] / "per_image.csv"))
        wanted = [(first, *view) for view in views]
        of_schedule = runs[(runs["scene"] == scene) & (runs["train"] == train)]
        for label in scenes.ablations_in_order(of_schedule["ablation"]):
            made_for = (scene, ablation_of(label)) in scenes.MADE_FOR_SCENE
            if made_for and baseline_of(label) == model:
                compared = [view for number, view in enumerate(views) if number == 0 or view[0] == MOTION]
                wanted += [(_first_seed(runs, scene, label, train), *view) for view in compared]
        for run, choice, view in wanted:
            try:
                strips.append(_strip(run, choice, view, model))
            except Exception as error:  # PIL raises many types for damaged files
                warnings.append(f"{run['run']}: no strip of {clear(view)}: {clear(error)}")
    return strips, warnings


def shown_experiment(runs: pd.DataFrame) -> tuple[str, str]:
    """(schedule, model) of one scene with the best mean final PSNR of `full`.

    Variants of a schedule (in brackets) count only if there are no other runs. Without `full`: of the first model.
    """
    unchanged = runs[[not parts_of(train)[1] for train in runs["train"]]]
    runs = runs if unchanged.empty else unchanged
    full = runs[runs["ablation"].map(requested) == "full"]
    if full.empty:
        full = runs[runs["ablation"] == scenes.ablations_in_order(runs["ablation"])[0]]
    return full.groupby(["train", "ablation"], sort=True)["final.psnr"].mean().idxmax()


def _first_seed(runs: pd.DataFrame, scene: str, model: str, train: str) -> pd.Series:
    return select(runs, scene, model, train).sort_values("seed").iloc[0]


def _strip(run: pd.Series, choice: str, view: str, chosen_for: str) -> Strip:
    """Raises whatever PIL raises for missing and damaged images."""
    folder = Path(run["folder"])
    parts: tuple[str, ...] = PARTS
    if choice == MOTION:
        webp = compose(moving_parts(folder / "renders", view))
    else:
        parts = (*PARTS, DEPTH) if (folder / "renders" / f"{view}_{DEPTH}.png").is_file() else PARTS
        webp = compose([opened(folder / "renders" / f"{view}_{part}.png") for part in parts])
    psnr = read_view_psnr(folder / "per_image.csv").get(view)
    viewer = folder / "viewer.html" if (folder / "viewer.html").is_file() else None
    which = run["scene"], run["ablation"], run["train"], int(run["seed"])
    return Strip(*which, view, choice, chosen_for, psnr, webp, viewer, choice != MOTION and DEPTH in parts)


def webp_name(*parts: str) -> str:
    """The parts joined to a file name that is valid in any file system."""
    return file_name("__".join(parts)) + ".webp"


def is_excluded(scene: str, no_pictures: tuple[str, ...]) -> bool:
    """Whether the scene or its family is one of those whose images may not be published."""
    return scene in no_pictures or scene.split("/")[0] in no_pictures


def choose_views(renders: Path, psnr_of: dict[str, float]) -> list[tuple[str, str]]:
    """(choice, view) of median and worst PSNR, and of most motion where it is known; without PSNRs the middle view by
    name; [] without images."""
    views = sorted(p.name.removesuffix("_render.png") for p in renders.glob("*_render.png"))
    moving = {view: moving_count(renders, view) for view in views}
    motion = [(MOTION, max(views, key=moving.__getitem__))] if any(moving.values()) else []
    known = sorted((psnr_of[v], v) for v in views if v in psnr_of)
    if not known:
        return [("example", views[len(views) // 2]), *motion] if views else []
    median, worst = known[len(known) // 2][1], known[0][1]
    return [("median", median)] + ([("worst", worst)] if worst != median else []) + motion


def opened(path: Path) -> Image.Image:
    """An image in RGB. Raises whatever PIL raises for missing and damaged images."""
    with Image.open(path) as image:
        return image.convert("RGB")


def compose(images: list[Image.Image], max_side: int = _MAX_SIDE) -> bytes:
    """The images side by side as WebP, with transparent gaps; images larger than `max_side` pixels are scaled down."""
    scale = min(1.0, max_side / max(images[0].size))
    size = (max(1, round(images[0].width * scale)), max(1, round(images[0].height * scale)))
    strip = Image.new("RGBA", (len(images) * size[0] + (len(images) - 1) * _GAP, size[1]), (0, 0, 0, 0))
    for i, full_size in enumerate(images):
        scaled = full_size if full_size.size == size else full_size.resize(size, Image.Resampling.LANCZOS)
        strip.paste(scaled, (i * (size[0] + _GAP), 0))
    buffer = io.BytesIO()
    strip.save(buffer, "WEBP", quality=_QUALITY)
    return buffer.getvalue()
