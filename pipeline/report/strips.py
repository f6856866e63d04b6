"""Image strips, render | truth | difference, and for driving logs depth, from the images in a run's renders/ folder.

Per scene one recipe: the one with the best mean final PSNR of `full`. Shown are the median and the worst view of `full`
and, where the dynamic region is known, the view with the largest: render and truth with its outline, and both enlarged
there, since a moving object that a model has lost is a small part of an image. Of the ablation that the scene was made
for the same median view, and that of motion. Other models are compared in tables. The figures that a run folder holds
are shown as they are.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from PIL import Image
from scipy.ndimage import binary_dilation, find_objects, label

from datasets.files.errors import DataError, clear, read_json
from pipeline.report import scenes
from pipeline.report.curve_figures import file_name
from pipeline.report.runs import RENDERED, read_view_psnr

MOVING_PARTS = ("render, dynamic region outlined", "truth", "render, enlarged", "truth, enlarged")
MOTION = "largest dynamic region"  # the choice of a view
_MAX_SIDE = 512  # pixels of a view, to limit the size of the page
_GAP = 6  # pixels between the parts
_QUALITY = 90  # of WebP; the exact images are in the run's renders/
DIFFERENCE_GAIN = 4  # of the difference images that pipeline/evaluation/pictures/view_pictures.py writes
FOLDER, INDEX = "figures", "figures.json"  # of a run folder, as pipeline/figures writes them
_MAX_FIGURE_SIDE = 1200  # pixels
OUTLINE = (255, 0, 200)  # RGB; rare in photographs
_MARGIN = 0.15  # of the enlarged object's size, on every side
_SMALLEST = 24  # pixels, side of what is enlarged

Box = tuple[int, int, int, int]  # left, upper, right, lower, as in PIL


@dataclass(frozen=True)
class Strip:
    """One view of one run; `webp` has the pictures of `parts` side by side."""

    scene: str
    model: str
    recipe_label: str
    seed: int
    view: str
    choice: str  # median | worst | example | MOTION: how the view was chosen
    chosen_for: str  # the model by whose PSNR it was chosen
    psnr: float | None  # of this view, dB
    parts: tuple[str, ...]  # render, truth, difference and, of driving logs, depth; or MOVING_PARTS
    webp: bytes
    viewer: Path | None  # the run's viewer.html

    @property
    def choice_text(self) -> str:
        """How the view was chosen, such as `median of full`."""
        same = self.chosen_for == self.model or self.choice == MOTION
        return self.choice if same else f"{self.choice} of {self.chosen_for}"

    @property
    def filename(self) -> str:
        """Unique among strips and valid in any file system."""
        return webp_name(self.scene, self.model, self.recipe_label, f"seed{self.seed}", self.choice, self.view)


@dataclass(frozen=True)
class RunFigure:
    """A picture from a run's folder that is shown as it is."""

    scene: str
    run: str  # "": of several runs
    title: str
    seen: str  # what is seen, a sentence
    filename: str
    webp: bytes


def make_strips(runs: pd.DataFrame, no_pictures: tuple[str, ...] = ()) -> tuple[list[Strip], list[str]]:
    """Strips in the order of the report, and a warning for each image that could not be read.

    no_pictures: scenes (dnerf/lego) or families (dnerf) without strips; a warning names them.
    """
    strips: list[Strip] = []
    warnings: list[str] = []
    for scene in scenes.in_order(runs["scene"]):
        if scenes.is_excluded(scene, no_pictures):
            warnings.append(f"{scene}: no pictures, as requested by --no-pictures")
            continue
        of_scene = runs[runs["scene"] == scene]
        recipe, model = shown_experiment(of_scene)
        of_recipe = of_scene[of_scene["recipe_label"] == recipe].sort_values(
            ["images", "seed"], ascending=[False, True]
        )
        first = of_recipe[of_recipe["model"] == model].iloc[0]
        views = choose_views(first["folder"] / "renders", read_view_psnr(first["folder"] / "per_image.csv"))
        wanted = [(first, *view) for view in views]
        made_for = [made.ablation for made in scenes.MADE_FOR if made.scene == scene and model == scenes.FULL]
        for _, ablated in of_recipe[of_recipe["model"].isin(made_for)].groupby("model"):
            compared = [view for number, view in enumerate(views) if number == 0 or view[0] == MOTION]
            wanted += [(ablated.iloc[0], *view) for view in compared]
        for run, choice, view in wanted:
            try:
                strips.append(_strip(run, choice, view, model))
            except Exception as error:  # PIL raises many types for damaged files
                warnings.append(f"{run['run']}: no strip of {clear(view)}: {clear(error)}")
    return strips, warnings


def shown_experiment(runs: pd.DataFrame) -> tuple[str, str]:
    """(recipe, model) of one scene with the best mean final PSNR of `full`, of the protocol that most runs follow.

    Changed recipes and images that were given only where there are no other runs. Without `full`: of the first model.
    """
    own = runs[runs["images"] == RENDERED]
    runs = runs if own.empty else own
    runs = runs[runs["protocol"] == runs["protocol"].mode()[0]]
    unchanged = runs[~runs["changed"]]
    runs = runs if unchanged.empty else unchanged
    full = runs[runs["model"] == scenes.FULL]
    if full.empty:
        full = runs[runs["model"] == scenes.models_in_order(runs["model"])[0]]
    return full.groupby(["recipe_label", "model"], sort=True)["final.psnr"].mean().idxmax()


def run_figures(runs: pd.DataFrame, no_pictures: tuple[str, ...] = ()) -> tuple[list[RunFigure], list[str]]:
    """What `python -m pipeline.figures` drew of one run a scene, and a warning for each that could not be read.

    The run is of the recipe and the model whose views are shown too, or else the first with figures.
    """
    found, warnings = [], []
    for scene in scenes.in_order(runs["scene"]):
        of_scene = runs[runs["scene"] == scene]
        with_figures = of_scene[[(Path(folder) / FOLDER / INDEX).is_file() for folder in of_scene["folder"]]]
        if with_figures.empty or scenes.is_excluded(scene, no_pictures):
            continue
        recipe, model = shown_experiment(of_scene)
        preferred = with_figures[(with_figures["recipe_label"] == recipe) & (with_figures["model"] == model)]
        run = (with_figures if preferred.empty else preferred).sort_values("seed").iloc[0]
        try:
            found += _figures(scene, run["run"], Path(run["folder"]) / FOLDER)
        except Exception as error:  # PIL raises many types for damaged files
            warnings.append(f"{run['run']}: no figures: {clear(error)}")
    return found, warnings


def _figures(scene: str, run: str, folder: Path) -> list[RunFigure]:
    """Raises whatever PIL raises for missing and damaged images, and DataError."""
    listed = read_json(folder / INDEX)
    if not isinstance(listed, list):
        raise DataError(folder / INDEX, "a list of figures", type(listed).__name__)
    figures = []
    for row in listed:
        keys = ("file", "title", "seen")
        if not isinstance(row, dict) or not all(isinstance(row.get(key), str) for key in keys):
            raise DataError(folder / INDEX, "file, title and seen of each figure", f"{row}")
        name = Path(row["file"]).name
        filename = webp_name(scene, FOLDER, Path(name).stem)
        webp = compose([opened(folder / name)], _MAX_FIGURE_SIDE)
        figures.append(RunFigure(scene, run, clear(row["title"]), clear(row["seen"]), filename, webp))
    return figures


def _strip(run: pd.Series, choice: str, view: str, chosen_for: str) -> Strip:
    """Raises whatever PIL raises for missing and damaged images."""
    folder = Path(run["folder"])
    files = {"render": "render", "truth": "truth", f"difference × {DIFFERENCE_GAIN}": "difference"}
    if (folder / "renders" / f"{view}_rendered_depth.png").is_file():
        files["depth"] = "rendered_depth"
    parts = MOVING_PARTS if choice == MOTION else tuple(files)
    if choice == MOTION:
        images = moving_parts(folder / "renders", view)
    else:
        images = [opened(folder / "renders" / f"{view}_{file}.png") for file in files.values()]
    psnr = read_view_psnr(folder / "per_image.csv").get(view)
    viewer = folder / "viewer.html" if (folder / "viewer.html").is_file() else None
    which = run["scene"], run["model"], run["recipe_label"], int(run["seed"])
    return Strip(*which, view, choice, chosen_for, psnr, parts, compose(images), viewer)


def webp_name(*parts: str) -> str:
    """The parts joined to a file name that is valid in any file system."""
    return file_name("__".join(parts)) + ".webp"


def choose_views(renders: Path, psnr_of: dict[str, float]) -> list[tuple[str, str]]:
    """(choice, view) of median and worst PSNR, and of the largest dynamic region where it is known.

    Without PSNRs the middle view by name; [] without images.
    """
    views = sorted(p.name.removesuffix("_render.png") for p in renders.glob("*_render.png"))
    moving = {view: moving_count(renders, view) for view in views}
    motion = [(MOTION, max(views, key=moving.__getitem__))] if any(moving.values()) else []
    known = sorted((psnr_of[v], v) for v in views if v in psnr_of)
    if not known:
        return [("example", views[len(views) // 2]), *motion] if views else []
    median, worst = known[len(known) // 2][1], known[0][1]
    return [("median", median)] + ([("worst", worst)] if worst != median else []) + motion


def moving_parts(renders: Path, view: str) -> list[Image.Image]:
    """Of MOVING_PARTS, all of the image's size. Raises whatever PIL raises for missing and damaged images."""
    mask = moving_mask(renders, view)
    pictures = [opened(renders / f"{view}_{part}.png") for part in ("render", "truth")]
    box = enlarged_box(mask)
    enlarged = [picture.crop(box).resize(picture.size, Image.Resampling.LANCZOS) for picture in pictures]
    return [*(outlined(picture, mask) for picture in pictures), *enlarged]


def moving_count(renders: Path, view: str) -> int:
    """The moving pixels of a view's mask; 0 if it cannot be read."""
    try:
        return int(moving_mask(renders, view).sum())
    except Exception:  # PIL raises many types for damaged files
        return 0


def moving_mask(renders: Path, view: str) -> np.ndarray:
    """(H, W) bool. Raises whatever PIL raises for missing and damaged images."""
    with Image.open(renders / f"{view}_moving.png") as image:
        return np.asarray(image.convert("L")) > 0


def outlined(picture: Image.Image, mask: np.ndarray) -> Image.Image:
    """The picture with a line around the mask (H, W) bool, outside of it."""
    width = max(1, round(max(picture.size) / 400))
    pixels = np.asarray(picture).copy()
    pixels[binary_dilation(mask, np.ones((3, 3)), iterations=width) & ~mask] = OUTLINE
    return Image.fromarray(pixels)


def enlarged_box(mask: np.ndarray) -> Box:
    """A box around the largest connected part of the mask, of the image's proportions and inside of it."""
    height, width = mask.shape
    parts, count = label(mask, np.ones((3, 3)))
    if not count:
        return 0, 0, width, height
    rows, columns = find_objects(parts)[int(np.bincount(parts.ravel())[1:].argmax())]
    needed = [(1 + 2 * _MARGIN) * (part.stop - part.start) for part in (columns, rows)]
    share = min(1.0, max(needed[0] / width, needed[1] / height, _SMALLEST / min(height, width)))
    size = max(1, round(share * width)), max(1, round(share * height))
    left, upper = (
        int(np.clip((part.start + part.stop - side) // 2, 0, whole - side))
        for part, side, whole in zip((columns, rows), size, (width, height))
    )
    return left, upper, left + size[0], upper + size[1]


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
