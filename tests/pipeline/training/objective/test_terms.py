"""A loss is a term: one is added here as CONTRIBUTING describes it, with its key and without other changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from tiny import TinyRun, fake_evaluate, tiny_config, tiny_scene

from pipeline.config.train_schema import RegularizationConfig
from pipeline.data.training_views import Target
from pipeline.model.initialise import initialise
from pipeline.model.model import Model
from pipeline.model.render import ImageGradient, Rendered
from pipeline.training.loop import train
from pipeline.training.objective import objective
from pipeline.training.objective.image_terms import image_terms
from pipeline.training.objective.terms import DrawnView


@dataclass
class WithKey(RegularizationConfig):
    """The schema of train.regularization with the key of a new loss."""

    fog: float = 0.0  # towards opaque pixels: × mean of 1 - alpha


@dataclass(frozen=True)
class Fog:
    """`weight` × the mean of 1 - alpha."""

    weight: float

    def outputs(self, target: Target) -> tuple[str, ...]:
        return ("alpha",)

    def __call__(self, rendered: Rendered, view: DrawnView) -> ImageGradient:
        gradient = torch.full_like(rendered.alpha, -self.weight / rendered.alpha.numel())
        return ImageGradient(self.weight * (1 - rendered.alpha).mean().item(), alpha=gradient).over(view.batch)


def trained_with(weight: float, path) -> Model:
    scene, cfg = tiny_scene(), tiny_config(20, regularization=WithKey(fog=weight))
    run = TinyRun(path / str(weight))
    return train(initialise(scene, cfg, np.random.default_rng(0)), scene, cfg, run, fake_evaluate).model


def test_a_new_loss_on_a_rendered_output_changes_the_training(tmp_path, monkeypatch) -> None:
    plain = trained_with(0.0, tmp_path)
    added = lambda train, *rest: [*image_terms(train, *rest), Fog(train.regularization.fog)]  # noqa: E731
    monkeypatch.setattr(objective, "image_terms", added)
    opacity = {weight: trained_with(weight, tmp_path).parameters["opacity_logit"] for weight in (0.0, 100.0)}
    assert torch.equal(opacity[0.0], plain.parameters["opacity_logit"]), "a weight of 0 changes nothing"
    assert opacity[100.0].sigmoid().mean() > opacity[0.0].sigmoid().mean() + 0.1


def test_sums_and_shares_of_gradients() -> None:
    one, other = torch.ones(1, 2, 2), torch.full((1, 2, 2), 3.0)
    total = ImageGradient(1.0, alpha=one) + ImageGradient(2.0, alpha=other, depth=one)
    assert total.loss == 3 and total.image is None and total.flow is None
    assert torch.equal(total.alpha, one + other) and torch.equal(total.depth, one)
    share = total.over(4)
    assert share.loss == 3 and torch.equal(share.alpha, one)
    mask = torch.tensor([[True, False], [True, True]])
    assert torch.equal(total.inside(mask).depth, mask[None].float())
