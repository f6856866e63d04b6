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

SMALLEST_SCALE = 1e-6  # units of time, a divisor: steps of velocities stay finite


def shared_tensors(model: Model) -> dict[str, Tensor]:
    """Those that are trained and do not have a row for each Gaussian, by their names in Model.state."""
    return {name: tensor for name, tensor in model.state().items() if name in ("environment", "trajectories")}


class Adam:
    """Adam (Kingma & Ba 2015) with 3DGS's β = (0.9, 0.999), ε = 1e-15 (the kernel's defaults) over all fields of
    `model` and its environment map.

    The step count of the bias correction is global, as in 3DGS: a new Gaussian starts with zero moments and the
    correction of the current step.

    The rate of velocities is that of the displacement in a Gaussian's temporal scale √Σtt: short-lived ones
    may be fast.
    """

    def __init__(self, model: Model, threads: int = 1) -> None:
        self.model = model
        self.threads = threads
        self.step_count = 0
        self.first = {name: torch.zeros_like(p) for name, p in model.parameters.items()}
        self.second = {name: torch.zeros_like(p) for name, p in model.parameters.items()}
        # Of what is not a row of each Gaussian, by name: "environment" and "trajectories", as in Model.state.
        self.shared_moments = {
            name: (torch.zeros_like(tensor), torch.zeros_like(tensor)) for name, tensor in shared_tensors(model).items()
        }

    def step(
        self,
        gradients: Gradients,
        learning_rates: dict[str, LearningRate],
        rows: Tensor | None = None,  # (N,) uint8, 0: unchanged, moments included; None: all are updated
        d_environment_map: Tensor | None = None,  # (3, h, 2h); None: the environment map is unchanged
    ) -> None:
        """One update of every parameter, in place. learning_rates: as schedule.Phase.lr; a field of rate 0 keeps its
        moments too."""
        self.step_count += 1
        for name, parameter in self.model.parameters.items():
            moments = self.first[name], self.second[name]
            rate = learning_rates[name]
            if rate == 0.0:  # velocities beside trajectories; weights of tracks
                continue
            if name == "sh":
                assert isinstance(rate, tuple)
                sh_adam_step(
                    parameter, gradients, *moments, rate, self.step_count, sparse_rows=rows, threads=self.threads
                )
                continue
            if isinstance(rate, tuple):
                rate = rate[: parameter.shape[1]]  # a static mean has no column for time
            gradient = getattr(gradients, name)
            stepped = torch.zeros_like(parameter) if name == "velocity" else parameter
            adam_step(stepped, gradient, *moments, rate, self.step_count, sparse_rows=rows, threads=self.threads)
            if name == "velocity":  # stepped: a displacement in one temporal scale
                parameter += stepped / self.model.parameters["log_scale"][:, 3:].exp().clamp_min(SMALLEST_SCALE)
        for name, gradient in (("environment", d_environment_map), ("trajectories", gradients.trajectories)):
            if gradient is None:
                continue
            tensors = (shared_tensors(self.model)[name], gradient, *self.shared_moments[name])
            parameter, gradient, first, second = (tensor.view(-1) for tensor in tensors)
            rate = learning_rates[name]
            adam_step(parameter, gradient, first, second, rate, self.step_count, threads=self.threads)

    def adopt(self, model: Model) -> None:
        """Go on with a model of the same Gaussians that has further tensors; their moments are zero."""
        self.model = model
        for moments in (self.first, self.second):
            moments |= {name: torch.zeros_like(p) for name, p in model.parameters.items() if name not in moments}
            moments["velocity"].zero_()  # now relative to the trajectories
        for name, tensor in shared_tensors(model).items():
            self.shared_moments.setdefault(name, (torch.zeros_like(tensor), torch.zeros_like(tensor)))

    def keep(self, rows: Tensor) -> None:
        """Keep the Gaussians `rows`, with their moments: (N,) bool, in their order, or indices, in that of these."""
        for tensors in (self.model.parameters, self.first, self.second):
            for name in tensors:
                tensors[name] = tensors[name][rows]
        if self.model.sphere is not None:
            self.model.sphere = self.model.sphere[rows]

    def append(self, rows: dict[str, Tensor]) -> None:
        """Append Gaussians, one row of every field each, with zero moments; they are not of the sphere."""
        parameters = self.model.parameters
        if set(rows) != set(parameters):
            raise ValueError(f"append: expected fields {sorted(parameters)}, found {sorted(rows)}")
        for tensors in (self.model.parameters, self.first, self.second):
            for name, new in rows.items():
                tensors[name] = torch.cat([tensors[name], new if tensors is parameters else torch.zeros_like(new)])
        if self.model.sphere is not None:
            others = torch.zeros(len(rows["mean"]), dtype=torch.bool, device=self.model.device)
            self.model.sphere = torch.cat([self.model.sphere, others])

    def zero_moments(self, name: str, rows: Tensor | slice = slice(None)) -> None:
        """Zero the moments of one field. rows: (N,) bool or a slice; all by default."""
        self.first[name][rows] = 0.0
        self.second[name][rows] = 0.0

    @property
    def bytes(self) -> int:
        """Size of the moments."""
        shared = [moment for moments in self.shared_moments.values() for moment in moments]
        tensors = [*self.first.values(), *self.second.values(), *shared]
        return sum(t.numel() * t.element_size() for t in tensors)
