"""Adam on a model, and the one place where rows of parameters and of Adam's state come and go together.

Every field has two moments of its own shape. Whatever changes the set of Gaussians, densification or pruning,
does it through `keep` and `append`, so that a moment can never end up beside the wrong parameter.
"""

from __future__ import annotations

import torch
from torch import Tensor

from pipeline.model.model import Model
from pipeline.training.schedule import LearningRate
from rasterizer import Gradients
from rasterizer.adam import adam_step, sh_adam_step


class Adam:
    """Adam with 3DGS's β = (0.9, 0.999), ε = 1e-15 (the kernel's defaults) over all fields of `model`, and over its
    environment where it has one.

    The step count of the bias correction is global: a Gaussian added late starts with zero moments and the
    correction of the current step, as in 3DGS.
    """

    def __init__(self, model: Model, threads: int = 1) -> None:
        self.model = model
        self.threads = threads
        self.step_count = 0
        self.first = {name: torch.zeros_like(p) for name, p in model.parameters.items()}
        self.second = {name: torch.zeros_like(p) for name, p in model.parameters.items()}
        environment_map = model.environment_map
        self.environment_map = (
            None if environment_map is None else tuple(torch.zeros_like(environment_map.image) for _ in range(2))
        )

    def step(
        self,
        gradients: Gradients,
        learning_rates: dict[str, LearningRate],
        rows: Tensor | None = None,  # (N,) uint8, 0 for Gaussians to leave alone, moments included; None: step all
        d_environment_map: Tensor | None = None,  # (3, h, 2h); None: leave the environment map alone
    ) -> None:
        """One update of every parameter, in place."""
        self.step_count += 1
        for name, parameter in self.model.parameters.items():
            moments = self.first[name], self.second[name]
            if name == "sh":
                sh_adam_step(
                    parameter,
                    gradients,
                    *moments,
                    learning_rates["sh"],
                    self.step_count,
                    sparse_rows=rows,
                    threads=self.threads,
                )
            else:
                rate = learning_rates[name]
                if isinstance(rate, tuple):
                    rate = rate[: parameter.shape[1]]  # a static mean has no column for time
                adam_step(
                    parameter,
                    getattr(gradients, name),
                    *moments,
                    rate,
                    self.step_count,
                    sparse_rows=rows,
                    threads=self.threads,
                )
        if d_environment_map is not None:
            tensors = (self.model.environment_map.image, d_environment_map, *self.environment_map)
            adam_step(
                *(t.view(-1) for t in tensors), learning_rates["environment_map"], self.step_count, threads=self.threads
            )

    def keep(self, mask: Tensor) -> None:
        """Keep the Gaussians where `mask` (N,) bool is true, with their moments, in their order."""
        for tensors in self._all():
            for name in tensors:
                tensors[name] = tensors[name][mask]
        if self.model.sphere is not None:
            self.model.sphere = self.model.sphere[mask]

    def append(self, rows: dict[str, Tensor]) -> None:
        """Add Gaussians, a row of every field each, with zero moments, after the present ones; not to the sphere."""
        parameters = self.model.parameters
        if set(rows) != set(parameters):
            raise ValueError(f"append: expected fields {sorted(parameters)}, found {sorted(rows)}")
        for tensors in self._all():
            for name, new in rows.items():
                tensors[name] = torch.cat([tensors[name], new if tensors is parameters else torch.zeros_like(new)])
        if self.model.sphere is not None:
            others = torch.zeros(len(rows["mean"]), dtype=torch.bool)
            self.model.sphere = torch.cat([self.model.sphere, others])

    def zero_moments(self, name: str, rows: Tensor | slice = slice(None)) -> None:
        """Forget the past of one field (after an opacity reset). rows: (N,) bool, or a slice; all of them."""
        self.first[name][rows] = 0.0
        self.second[name][rows] = 0.0

    def _all(self) -> tuple[dict[str, Tensor], dict[str, Tensor], dict[str, Tensor]]:
        return self.model.parameters, self.first, self.second

    @property
    def bytes(self) -> int:
        """Size of the moments."""
        tensors = [*self.first.values(), *self.second.values(), *(self.environment_map or ())]
        return sum(t.numel() * t.element_size() for t in tensors)
