"""The trained model: one float32 tensor per field of docs/method.md 1, and its background model.

`ModelKind` determines which tensors there are and their shapes: a static model stores no time, a model without 4D
rotation no right quaternion, a model without Fourier orders no coefficients for them. With motion "velocity" there are
velocities in place of a 4D rotation (transformed.py), and there may be trajectories that Gaussians share, with a
weight of each Gaussian for each (rasterizer/trajectories.py). With a background model there is
also the label of the Gaussians on the sphere around the scene (sphere.py), the environment map (environment_map.py) or,
in its place, the cube map (cube_map.py).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.model.cube_map import CubeMap
from pipeline.model.environment_map import EnvironmentMap
from rasterizer.gaussians import Gaussians, Motion
from rasterizer.trajectories import Trajectories

BackgroundMap = EnvironmentMap | CubeMap
CPU = torch.device("cpu")
GLOBAL_TENSORS = ("environment", "trajectories", "span")  # of `Model.state()`: not one row per Gaussian


@dataclass(frozen=True)
class ModelKind:
    """Motion, Fourier order and SH degree, which determine the shapes of a model's tensors."""

    motion: Motion  # static: 3D; separable: 4D without rotation into time; full: 4D; velocity: the same, in training
    fourier_order: int  # 0 to 2; 0 when static
    sh_degree: int  # 0 to 3
    trajectories: int = 0  # how many Gaussians share, with motion "velocity"

    @property
    def dims(self) -> int:
        """3 (xyz) or 4 (xyzt)."""
        return 3 if self.motion == "static" else 4

    @property
    def moves(self) -> bool:
        """Whether its Gaussians have velocities."""
        return self.motion in ("full", "velocity")

    @property
    def coefficients(self) -> int:
        """4DSH coefficients per colour channel, (n+1)(l+1)²."""
        return (self.fourier_order + 1) * (self.sh_degree + 1) ** 2

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Field name -> shape of one Gaussian's row, in storage order."""
        shapes: dict[str, tuple[int, ...]] = {
            "mean": (self.dims,),
            "log_scale": (self.dims,),
            "quat_left": (4,),
            "quat_right": (4,),
            "opacity_logit": (),
            "sh": (self.coefficients, 3),
        }
        if self.motion != "full":
            del shapes["quat_right"]
        if self.motion == "velocity":
            shapes["velocity"] = (3,)
        if self.trajectories:
            shapes["weights"] = (self.trajectories,)
        return shapes


def kind_of(scene: Scene, cfg: Config) -> ModelKind:
    """The kind of model for a scene under an ablation.

    `ablation.static` overrides a static `scene.capture`. A static model has Fourier order 0 whatever the ablation says.
    """
    static = scene.capture == "static" if cfg.ablation.static is None else cfg.ablation.static
    if static:
        return ModelKind("static", 0, cfg.ablation.sh_degree)
    motion: Motion = "full" if cfg.ablation.rotation_4d else "separable"
    return ModelKind(motion, cfg.ablation.fourier_order, cfg.ablation.sh_degree)


def background_map(image: Tensor) -> BackgroundMap:
    """The map whose `image` this is."""
    return CubeMap(image) if image.dim() == 4 else EnvironmentMap(image)


class Model:
    """N Gaussians as float32 contiguous tensors by field name.

    `parameters` is replaced row-wise by densification (see optimiser.py) and changed in place by Adam.
    """

    def __init__(
        self,
        kind: ModelKind,
        parameters: dict[str, Tensor],
        sphere: Tensor | None = None,
        environment_map: BackgroundMap | None = None,
        trajectories: Trajectories | None = None,
    ) -> None:
        """sphere: (N,) bool, which Gaussians are on the sphere around the scene; None without a sphere.

        Raises ValueError naming the field whose presence, dtype or shape does not fit `kind`.
        """
        shapes = kind.shapes()
        if set(parameters) != set(shapes):
            raise ValueError(f"{kind.motion} model: expected fields {list(shapes)}, found {sorted(parameters)}")
        n = parameters["mean"].shape[0]
        for name, row in shapes.items():
            tensor = parameters[name]
            if tensor.dtype != torch.float32 or tuple(tensor.shape) != (n, *row):
                raise ValueError(f"{name}: expected float32 {[n, *row]}, found {tensor.dtype} {list(tensor.shape)}")
        if sphere is not None and (sphere.dtype != torch.bool or tuple(sphere.shape) != (n,)):
            raise ValueError(f"sphere: expected bool {[n]}, found {sphere.dtype} {list(sphere.shape)}")
        if (0 if trajectories is None else len(trajectories)) != kind.trajectories:
            raise ValueError(f"trajectories: expected {kind.trajectories}, found {trajectories and len(trajectories)}")
        self.kind = kind
        self.parameters = {name: parameters[name].contiguous() for name in shapes}
        self.sphere = sphere
        self.environment_map = environment_map
        self.trajectories = trajectories

    @classmethod
    def from_gaussians(cls, gaussians: Gaussians) -> Model:
        shared = 0 if gaussians.trajectories is None else len(gaussians.trajectories)
        kind = ModelKind(gaussians.motion, gaussians.fourier_order, gaussians.sh_degree, shared)
        return cls(kind, gaussians.row_tensors(), trajectories=gaussians.trajectories)

    def with_parameters(self, parameters: dict[str, Tensor], motion: Motion | None = None) -> Model:
        """The same model with other values of its fields, and if given another motion. It shares all else."""
        kind = self.kind if motion is None else replace(self.kind, motion=motion)
        return Model(kind, parameters, self.sphere, self.environment_map, self.trajectories)

    def gaussians(self) -> Gaussians:
        """The rasterizer's input; it shares the tensors."""
        fields: dict[str, Any] = {"quat_right": None, **self.parameters}
        return Gaussians(**fields, trajectories=self.trajectories)

    def to(self, device: torch.device) -> Model:
        """The same model with its tensors on the device; itself if they are."""
        if self.device == device:
            return self
        state = {name: tensor if name == "span" else tensor.to(device) for name, tensor in self.state().items()}
        return Model.restored(self.kind, state)

    @property
    def device(self) -> torch.device:
        return self.parameters["mean"].device

    def copy(self) -> Model:
        return Model.restored(self.kind, {name: tensor.clone() for name, tensor in self.state().items()})

    def state(self) -> dict[str, Tensor]:
        """All tensors by name (not copies), including those of the background model."""
        state = dict(self.parameters)
        if self.sphere is not None:
            state["sphere"] = self.sphere
        if self.environment_map is not None:
            state["environment"] = self.environment_map.image
        if self.trajectories is not None:
            state["trajectories"] = self.trajectories.control_points
            state["span"] = torch.tensor(self.trajectories.span, dtype=torch.float64)
        return state

    @classmethod
    def restored(cls, kind: ModelKind, state: dict[str, Tensor]) -> Model:
        """The model whose `state()` this is."""
        parameters = {name: tensor for name, tensor in state.items() if name not in ("sphere", *GLOBAL_TENSORS)}
        environment_map = background_map(state["environment"]) if "environment" in state else None
        trajectories = None
        if "trajectories" in state:
            start, end = state["span"].tolist()
            trajectories = Trajectories(state["trajectories"], (start, end))
        return cls(kind, parameters, state.get("sphere"), environment_map, trajectories)

    def checked(self) -> Model:
        """The model itself. Raises ValueError for a NaN or Inf and for Gaussians that the rasterizer refuses."""
        if found := self.first_non_finite():
            raise ValueError(f"{found[0]} of Gaussian {found[1]}: expected a finite number, found NaN or Inf")
        if self.environment_map is not None:
            image = self.environment_map.image
            if image.numel() == 0 or not torch.isfinite(image).all():
                raise ValueError("environment map: expected finite pixels, found NaN, Inf or none")
        if self.trajectories is not None and not torch.isfinite(self.trajectories.control_points).all():
            raise ValueError("trajectories: expected finite control points, found NaN or Inf")
        self.gaussians()
        return self

    def __len__(self) -> int:
        return self.parameters["mean"].shape[0]

    @property
    def background_model(self) -> str:
        """none, sphere, envmap or cubemap, as in the configuration."""
        if self.environment_map is not None:
            return "cubemap" if isinstance(self.environment_map, CubeMap) else "envmap"
        return "none" if self.sphere is None else "sphere"

    @property
    def bytes(self) -> int:
        """Size of the parameters, environment map included; with Adam's two moments three times as much."""
        tensors = list(self.parameters.values())
        if self.trajectories is not None:
            tensors.append(self.trajectories.control_points)
        gaussians = sum(tensor.numel() * tensor.element_size() for tensor in tensors)
        return gaussians + (self.environment_map.bytes if self.environment_map else 0)

    def first_non_finite(self) -> tuple[str, int] | None:
        """(field, Gaussian index) of the first value that is NaN or Inf, or None."""
        for name, tensor in self.parameters.items():
            # One pass without allocation: a float64 sum of finite float32 values cannot overflow.
            if not torch.isfinite(tensor.sum(dtype=torch.float64)):
                rows = ~torch.isfinite(tensor.reshape(len(self), -1)).all(dim=1)
                return name, int(rows.nonzero()[0])
        return None
