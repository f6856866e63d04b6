"""Adam on a model; it also adds and removes Gaussians, with their moments.

Every field has two moments of its own shape. Densification and pruning change the set of Gaussians only through `keep`
and `append`, so that parameters and moments always have the same rows.
"""

from __future__ import annotations

import torch
from torch import Tensor

from pipeline.model.model import Model
from pipeline.training.schedule import LearningRate
from rasterizer import Gradients
from rasterizer.adam import adam_step, sh_adam_step


class Adam:
    """Adam (Kingma & Ba 2015) with 3DGS's β = (0.9, 0.999), ε = 1e-15 (the kernel's defaults) over all fields of
    `model` and its environment map.

    The step count of the bias correction is global, as in 3DGS: a new Gaussian starts with zero moments and the
    correction of the current step.
    """

    def __init__(self, model: Model, threads: int = 1) -> None:
        self.model = model
        self.threads = threads
        self.step_count = 0
        self.first = {name: torch.zeros_like(p) for name, p in model.parameters.items()}
        self.second = {name: torch.zeros_like(p) for name, p in model.parameters.items()}
        self.environment_map_moments: tuple[Tensor, Tensor] | None = None
        if model.environment_map is not None:
            image = model.environment_map.image
            self.environment_map_moments = torch.zeros_like(image), torch.zeros_like(image)

    def step(
        self,
        gradients: Gradients,
        learning_rates: dict[str, LearningRate],
        rows: Tensor | None = None,  # (N,) uint8, 0: unchanged, moments included; None: all are updated
        d_environment_map: Tensor | None = None,  # (3, h, 2h); None: the environment map is unchanged
    ) -> None:
        """One update of every parameter, in place. learning_rates: as schedule.Phase.lr."""
        self.step_count += 1
        for name, parameter in self.model.parameters.items():
            moments = self.first[name], self.second[name]
            rate = learning_rates[name]
            if name == "sh":
                assert isinstance(rate, tuple)
                sh_adam_step(
                    parameter, gradients, *moments, rate, self.step_count, sparse_rows=rows, threads=self.threads
                )
                continue
            if isinstance(rate, tuple):
                rate = rate[: parameter.shape[1]]  # a static mean has no column for time
            gradient = getattr(gradients, name)
            adam_step(parameter, gradient, *moments, rate, self.step_count, sparse_rows=rows, threads=self.threads)
        if d_environment_map is not None:
            assert self.model.environment_map is not None and self.environment_map_moments is not None
            image, rate = self.model.environment_map.image, learning_rates["environment_map"]
            first, second = (moment.view(-1) for moment in self.environment_map_moments)
            gradient = d_environment_map.view(-1)
            adam_step(image.view(-1), gradient, first, second, rate, self.step_count, threads=self.threads)

    def keep(self, mask: Tensor) -> None:
        """Remove the Gaussians where `mask` (N,) bool is False, with their moments; the others keep their order."""
        for tensors in (self.model.parameters, self.first, self.second):
            for name in tensors:
                tensors[name] = tensors[name][mask]
        if self.model.sphere is not None:
            self.model.sphere = self.model.sphere[mask]

    def append(self, rows: dict[str, Tensor]) -> None:
        """Append Gaussians, one row of every field each, with zero moments; they are not of the sphere."""
        parameters = self.model.parameters
        if set(rows) != set(parameters):
            raise ValueError(f"append: expected fields {sorted(parameters)}, found {sorted(rows)}")
        for tensors in (self.model.parameters, self.first, self.second):
            for name, new in rows.items():
                tensors[name] = torch.cat([tensors[name], new if tensors is parameters else torch.zeros_like(new)])
        if self.model.sphere is not None:
            others = torch.zeros(len(rows["mean"]), dtype=torch.bool)
            self.model.sphere = torch.cat([self.model.sphere, others])

    def zero_moments(self, name: str, rows: Tensor | slice = slice(None)) -> None:
        """Zero the moments of one field. rows: (N,) bool or a slice; all by default."""
        self.first[name][rows] = 0.0
        self.second[name][rows] = 0.0

    @property
    def bytes(self) -> int:
        """Size of the moments."""
        tensors = [*self.first.values(), *self.second.values(), *(self.environment_map_moments or ())]
        return sum(t.numel() * t.element_size() for t in tensors)
