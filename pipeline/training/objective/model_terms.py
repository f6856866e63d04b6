"""The losses on the parameters of the model. None is in the paper.

To add one, write its term, enter it in `model_terms`, and give its weight a key in pipeline/config/train_schema.py.
"""

from __future__ import annotations

from datasets.scene import Scene
from pipeline.config.train_schema import RegularizationConfig
from pipeline.training.objective.released_rigid import ReleasedRigid
from pipeline.training.objective.rigid_neighbours import RigidNeighbours
from pipeline.training.objective.terms import ModelTerm
from pipeline.training.objective.transparency import Transparency, relative_to_data


def model_terms(rules: RegularizationConfig, scene: Scene, threads: int, seed: int) -> list[ModelTerm]:
    """The losses of a schedule, in the order in which their gradients are added."""
    terms: list[ModelTerm] = [
        RigidNeighbours(rules.rigid, scene, seed),
        ReleasedRigid(rules.rigid_released, scene.duration, threads),
        Transparency(relative_to_data(rules, scene), scene),
    ]
    return [term for term in terms if term.weight > 0]
