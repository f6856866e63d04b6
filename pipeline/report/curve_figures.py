"""Groups learning curves into figures: per scene one of recipes, and one of models for each recipe."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass

from pipeline.report import scenes
from pipeline.report.runs import Collection

MOST_LINES = 8  # of a figure; the first is in every figure of a longer list
_MAX_BYTES = 150  # of a file name; file systems allow 255, with the suffix and the prefix of a temporary file


@dataclass(frozen=True)
class Line:
    """The seeds of one experiment on a scene, drawn as one line."""

    recipe_label: str
    model: str
    label: str


@dataclass(frozen=True)
class CurveFigure:
    """The lines of one figure. Titles and slugs are unique."""

    scene_label: str
    title: str  # `synthetic/wheel: models, fast`
    lines: tuple[Line, ...]

    @property
    def slug(self) -> str:
        return file_name(self.title.replace(": ", "__")).strip("_")


def file_name(text: str) -> str:
    """`text` as a file name that any file system takes: other characters than letters, digits and _ - . become one _,
    and of what is too long the beginning and a hash are left."""
    text = re.sub(r"[^\w.-]+", "_", text)
    encoded = text.encode()
    if len(encoded) <= _MAX_BYTES:
        return text
    return f"{encoded[:_MAX_BYTES].decode(errors='ignore')}_{hashlib.blake2b(encoded, digest_size=4).hexdigest()}"


def curve_figures(collection: Collection) -> list[CurveFigure]:
    """All figures, by scene. Every curve with at least two evaluations is in one."""
    curves = collection.curves
    curves = curves[curves.groupby("run")["iteration"].transform("size") > 1]
    found: list[CurveFigure] = []
    for scene in scenes.in_order(curves["scene_label"]):
        of_scene = curves[curves["scene_label"] == scene]
        recipes = sorted(of_scene["recipe_label"].unique(), key=lambda name: (" (" in name, name))
        models = {name: of_scene[of_scene["recipe_label"] == name]["model"] for name in recipes}
        several = {name: scenes.models_in_order(found) for name, found in models.items() if found.nunique() > 1}
        lines = [
            Line(name, model, name if model == scenes.FULL else f"{name}, {model}")
            for name in recipes
            for model in scenes.models_in_order(models[name])
            if model == scenes.FULL or name not in several
        ]
        if len(lines) > 1:
            found += _split(scene, "recipes", lines)
        elif lines and lines[0].recipe_label not in several:
            found.append(CurveFigure(scene, f"{scene}: {lines[0].label}", tuple(lines)))
        for name, shown in several.items():
            found += _split(scene, f"models, {name}", [Line(name, model, model) for model in shown])
    return found


def _split(scene: str, title: str, lines: list[Line]) -> list[CurveFigure]:
    """One figure, or several with the first line in each."""
    first, others = lines[0], lines[1:]
    parts = [others[i : i + MOST_LINES - 1] for i in range(0, len(others), MOST_LINES - 1)]
    titles = [f"{scene}: {title}" + (f", part {i}" if len(parts) > 1 else "") for i in range(1, len(parts) + 1)]
    return [CurveFigure(scene, name, (first, *part)) for name, part in zip(titles, parts)]
