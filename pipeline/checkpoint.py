"""One file from which a run continues as if it had never stopped.

A checkpoint is written beside its final name, synced to the disk and renamed over it, so that at any moment, also
after a kill or a power cut, the name holds either the old one or the new one, whole.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from pipeline.model import Model, ModelKind

FILE_NAME = "checkpoint.safetensors"
VERSION = 1


@dataclass(frozen=True)
class Checkpoint:
    """Everything the rest of a run depends on, besides its configuration and data."""

    iteration: int  # the last one done
    train_seconds: float  # evaluation excluded
    seed: int
    model: Model
    step_count: int  # Adam's
    moments: tuple[dict[str, Tensor], dict[str, Tensor]] | None  # None: dropped after the end of training
    environment_moments: tuple[Tensor, Tensor] | None  # likewise, or the model has no environment
    statistics: dict[str, Tensor]  # densification's, densify.Statistics.state()
    sampler: dict  # sampling.BatchSampler.state()
    split_generator: Tensor  # torch.Generator.get_state()
    best: dict | None  # metrics and iteration of the best evaluation so far
    best_model: Model | None


def save(path: Path, checkpoint: Checkpoint) -> None:
    """Write `path` durably. The same checkpoint gives the same bytes."""
    c = checkpoint
    tensors = {f"model.{name}": t for name, t in c.model.state().items()}
    for order, moments in zip(("first", "second"), c.moments or ()):
        tensors |= {f"{order}.{name}": t for name, t in moments.items()}
    for order, moment in zip(("first", "second"), c.environment_moments or ()):
        tensors[f"environment.{order}"] = moment
    tensors |= {f"statistics.{name}": t for name, t in c.statistics.items()}
    if c.best_model is not None:
        tensors |= {f"best.{name}": t for name, t in c.best_model.state().items()}
    tensors["sampler.order"] = torch.from_numpy(c.sampler["order"])
    tensors["split_generator"] = c.split_generator
    kind = c.model.kind
    header = {
        "version": VERSION, "iteration": c.iteration, "train_seconds": c.train_seconds, "seed": c.seed,
        "step_count": c.step_count, "best": c.best,
        "kind": [kind.motion, kind.fourier_order, kind.sh_degree],
        "sampler": {key: c.sampler[key] for key in ("position", "generator")},
    }
    temporary = path.with_name(path.name + ".tmp")
    # A single metadata key: with several, safetensors writes them in an order that changes from run to run.
    save_file(tensors, temporary, metadata={"state": json.dumps(header, sort_keys=True)})
    _sync(temporary)
    os.replace(temporary, path)
    _sync(path.parent)


def load(path: Path) -> Checkpoint:
    """Read a checkpoint back. Raises ValueError, one line with the file's name, when it is not one."""
    header, tensors = _read(path)
    if header.get("version") != VERSION:
        raise ValueError(f"{path}: expected checkpoint version {VERSION}, found {header.get('version')}")
    kind = ModelKind(*header["kind"])
    groups: dict[str, dict[str, Tensor]] = {}
    for name, tensor in tensors.items():
        group, _, rest = name.partition(".")
        groups.setdefault(group, {})[rest] = tensor
    environment = groups.get("environment")
    sampler = dict(header["sampler"], order=tensors["sampler.order"].numpy())
    return Checkpoint(
        iteration=header["iteration"], train_seconds=header["train_seconds"], seed=header["seed"],
        model=Model.restored(kind, groups["model"]), step_count=header["step_count"],
        moments=(groups["first"], groups["second"]) if "first" in groups else None,
        environment_moments=(environment["first"], environment["second"]) if environment else None,
        statistics=groups["statistics"], sampler=sampler, split_generator=tensors["split_generator"],
        best=header["best"], best_model=Model.restored(kind, groups["best"]) if "best" in groups else None)


def load_model(path: Path) -> Model:
    """The model of a checkpoint alone, without reading Adam's moments."""
    header, tensors = _read(path, prefix="model.")
    state = {name.removeprefix("model."): tensor for name, tensor in tensors.items()}
    return Model.restored(ModelKind(*header["kind"]), state)


def _read(path: Path, prefix: str = "") -> tuple[dict, dict[str, Tensor]]:
    try:
        with safe_open(path, framework="pt") as file:
            header = json.loads((file.metadata() or {})["state"])
            return header, {name: file.get_tensor(name) for name in file.keys() if name.startswith(prefix)}
    except (SafetensorError, KeyError, json.JSONDecodeError) as error:
        raise ValueError(f"{path}: expected a checkpoint of this program, found {error}") from error


def _sync(path: Path) -> None:
    """Force a file, or a directory's entries, to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
