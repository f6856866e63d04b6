"""What a loss is: a term of the objective. The losses themselves are in image_terms.py and model_terms.py.

The loss of a batch is the mean over its views of the sum of all terms.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from pipeline.data.training_views import Target
from pipeline.model.model import Model
from pipeline.model.render import ImageGradient, Rendered
from pipeline.training.objective.neighbours import Neighbours
from pipeline.training.schedule import Phase
from rasterizer import Gradients


@dataclass(frozen=True)
class DrawnView:
    """A training view of a batch, and what is drawn for it."""

    target: Target
    phase: Phase
    batch: int = 1  # views of its batch
    place: int = 0  # in its batch
    number: int = 1  # training views since the start of the run, this one included
    marginal_offset: float = 0.0  # its temporal marginals are those of its time + this
    neighbours: Neighbours | None = None  # for the rigidity of shared motion; only the batch's first view has them


class ImageTerm(Protocol):
    """A loss on the rendered outputs of a view.

    Pixels outside the view's mask need no care: the target has the rendered colour there and no flow, depth or sky, and
    the gradient there is set to zero.
    """

    @property
    def weight(self) -> float: ...  # 0: the term is left out

    def outputs(self, target: Target) -> tuple[str, ...]:
        """The outputs of rasterizer.Request that the loss of this view needs; none where it has no such loss."""

    def __call__(self, rendered: Rendered, view: DrawnView) -> ImageGradient:
        """The loss of the view; its gradient by the rendered outputs is that of the batch's loss."""


class ModelTerm(Protocol):
    """A loss on the parameters of the model."""

    @property
    def weight(self) -> float: ...  # 0: the term is left out

    def add(self, gradients: Gradients, model: Model, view: DrawnView) -> float:
        """Called after each view: add the gradient of the batch's loss to `gradients`, in place, if it is this view's
        turn. Returns the loss, as a part of this view's; 0 where it is not this view's turn or is not computed."""
