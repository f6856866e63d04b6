"""Adam on a model, and the one place where rows of parameters and of Adam's state come and go together.

Every field has two moments of its own shape. Whatever changes the set of Gaussians, densification or pruning,
does it through `keep` and `append`, so that a moment can never end up beside the wrong parameter.
"""

from __future__ import annotations

import torch
from torch import Tensor

from pipeline.model import Model
from pipeline.schedule import Rate
from rasterizer import Gradients
from rasterizer.adam import adam_step, sh_adam_step


class Adam:
    """Adam with 3DGS's β = (0.9, 0.999), ε = 1e-15 (the kernel's defaults) over all fields of `model`.

    The step count of the bias correction is global: a Gaussian added late starts with zero moments and the
    correction of the current step, as in 3DGS. `sparse`: only rows touched by the batch are updated, the moments of
    the others left to rest (faster, and not the paper's).
    """

    def __init__(self, model: Model, sparse: bool = False, threads: int = 1) -> None:
        self.model = model
        self.sparse = sparse
        self.threads = threads
        self.step_count = 0
        self.first = {name: torch.zeros_like(p) for name, p in model.parameters.items()}
        self.second = {name: torch.zeros_like(p) for name, p in model.parameters.items()}

    def step(
        self,
        gradients: Gradients,
        rates: dict[str, Rate],
        touched: Tensor | None = None,  # (N,) uint8, 1 where the batch saw the Gaussian; needed when sparse
    ) -> None:
        """One update of every parameter, in place."""
        self.step_count += 1
        rows = touched if self.sparse else None
        for name, parameter in self.model.parameters.items():
            moments = self.first[name], self.second[name]
            if name == "sh":
                sh_adam_step(parameter, gradients, *moments, *rates["sh"], self.step_count, sparse=self.sparse,
                             threads=self.threads)
            else:
                rate = rates[name]
                if isinstance(rate, tuple):
                    rate = rate[: parameter.shape[1]]  # a static mean has no column for time
                adam_step(parameter, getattr(gradients, name), *moments, rate, self.step_count, sparse_rows=rows,
                          threads=self.threads)

    def keep(self, mask: Tensor) -> None:
        """Keep the Gaussians where `mask` (N,) bool is true, with their moments, in their order."""
        for tensors in self._all():
            for name in tensors:
                tensors[name] = tensors[name][mask]

    def append(self, rows: dict[str, Tensor]) -> None:
        """Add Gaussians, a row of every field each, with zero moments, after the present ones."""
        parameters = self.model.parameters
        if set(rows) != set(parameters):
            raise ValueError(f"append: expected fields {sorted(parameters)}, found {sorted(rows)}")
        for tensors in self._all():
            for name, new in rows.items():
                tensors[name] = torch.cat([tensors[name], new if tensors is parameters else torch.zeros_like(new)])

    def zero_moments(self, name: str) -> None:
        """Forget the past of one field (after an opacity reset)."""
        self.first[name].zero_()
        self.second[name].zero_()

    def _all(self) -> tuple[dict[str, Tensor], dict[str, Tensor], dict[str, Tensor]]:
        return self.model.parameters, self.first, self.second

    @property
    def bytes(self) -> int:
        """Size of the moments."""
        return sum(t.numel() * t.element_size() for d in (self.first, self.second) for t in d.values())
