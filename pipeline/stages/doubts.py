"""Doubts that a training has learnt anything, said while it runs and after it: it must beat its rivals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict

from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.evaluation.renderer import Renderer
from pipeline.evaluation.rivals import AgainstRivals, Rivals
from pipeline.model.model import Model
from pipeline.training.reporting import Progress, StepReport
from rasterizer import Engine

FIRST_LOOK = 0.1  # of the schedule
COLLAPSED = 0.1  # of the initial Gaussians
Say = Callable[[dict, str], None]
CAUSE = "the poses, the times, the unit of length or the initial points may not be those of the images"


def doubt(initial: int, left: int, densified: bool, against: AgainstRivals) -> str | None:
    """One line, or None where the model beats its rivals and has not collapsed. initial, left: numbers of Gaussians.
    densified: whether densification was due at all."""
    signs = []
    if not against.beaten:
        signs.append(f"it is no better than a picture of the data ({against})")
    if left < COLLAPSED * initial and signs:
        signs.append(f"{left} of {initial} initial Gaussians are left")
    elif densified and left == initial:
        signs.append(f"the {initial} initial Gaussians are all that there are, though densification was due")
    return f"{' and '.join(signs)}: {CAUSE}" if signs else None


class EarlyDoubts:
    """Observes a training: compares it with its rivals early and when its Gaussians vanish, and says where it does not
    beat them; after that at each evaluation, until it does."""

    def __init__(self, initial: int, scene: Scene, cfg: Config, rasterizer: Engine, say: Say) -> None:
        """initial: number of Gaussians. say: takes a row of log.jsonl and a line for the user."""
        self._initial, self._scene, self._cfg = initial, scene, cfg
        self._rasterizer, self._say = rasterizer, say
        self._rivals: Rivals | None = None
        self._looked = self._collapsed = self._doubted = False

    def start(self, iteration: int) -> None:
        """Nothing to see yet."""

    def step(self, model: Model, report: StepReport) -> None:
        collapses = not self._collapsed and report.n_gaussians < COLLAPSED * self._initial
        self._collapsed |= collapses
        if collapses or (not self._looked and report.iteration >= FIRST_LOOK * self._cfg.train.iterations):
            self._look(model, report)

    def evaluated(self, model: Model, progress: Progress, metrics: dict) -> None:
        if self._doubted:
            self._look(model, progress)

    def _look(self, model: Model, progress: Progress) -> None:
        self._rivals = self._rivals or Rivals(self._scene, self._cfg.train.resolution_scale)
        found = self._rivals.compare(Renderer(model, self._scene, self._cfg, self._rasterizer))
        before, self._doubted, self._looked = self._doubted, not found.beaten, True
        if self._doubted != before:
            said = "better now than" if found.beaten else "no better yet than"
            row = {"event": "rivals", "iteration": progress.iteration, **asdict(found)}
            self._say(row, f"iteration {progress.iteration}: {said} a picture of the data (held-out views, {found})")
