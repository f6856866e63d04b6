"""Checkpoint of a training run: one file, from which the run continues with the same bits as without an interruption.

The write is atomic (datasets/files/atomic_write.py): after a kill, a power failure or on a full disk the file is either
the old checkpoint or the new one.
"""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from datasets.files.atomic_write import atomic_file
from datasets.files.errors import DataError
from pipeline.config.schema import MAX_SEED
from pipeline.model.model import Model, ModelKind
from pipeline.model.transformed import in_rotations
from pipeline.training.density.statistics import Statistics
from pipeline.training.objective.neighbours import Neighbours
from pipeline.training.optimiser import shared_tensors
from pipeline.training.reporting import Spent
from rasterizer.gaussians import MAX_FOURIER_ORDER, SH_DEGREES, Motion

FILE_NAME = "checkpoint.safetensors"
VERSION = 2


@dataclass(frozen=True)
class Checkpoint:
    """Everything that the rest of a run depends on, besides its configuration and data."""

    iteration: int  # the last completed one
    spent: Spent
    seed: int
    model: Model
    step_count: int  # of Adam
    moments: tuple[dict[str, Tensor], dict[str, Tensor]]  # of Adam
    shared_moments: dict[str, tuple[Tensor, Tensor]]  # likewise, of optimiser.shared_tensors
    statistics: dict[str, Tensor]  # density.statistics.Statistics.state()
    sampler: dict  # sampling.BatchSampler.state()
    split_rng: Tensor  # torch.Generator.get_state()
    best: dict | None  # metrics and iteration of the evaluation with the highest PSNR
    best_model: Model | None
    neighbours: Neighbours | None  # of the Gaussians, since the last change of their set


def save(path: Path, checkpoint: Checkpoint) -> None:
    """Write `path` atomically. Equal checkpoints give equal bytes. Raises OSError where the disk does."""
    c = checkpoint
    tensors = {f"model.{name}": t for name, t in c.model.state().items()}
    for order, moments in zip(("first", "second"), c.moments):
        tensors |= {f"{order}.{name}": t for name, t in moments.items()}
    for name, of_name in c.shared_moments.items():
        tensors |= {f"{name}.{order}": moment for order, moment in zip(("first", "second"), of_name)}
    tensors |= {f"statistics.{name}": t for name, t in c.statistics.items()}
    if c.best_model is not None:
        tensors |= {f"best.{name}": t for name, t in c.best_model.state().items()}
    if c.neighbours is not None:
        tensors["neighbours"] = c.neighbours.index
    tensors["sampler.order"] = torch.from_numpy(c.sampler["order"])
    tensors["split_generator"] = c.split_rng
    kind = c.model.kind
    header = {
        "version": VERSION,
        "iteration": c.iteration,
        "train_seconds": c.spent.seconds,
        "cpu_seconds": c.spent.cpu_seconds,
        "seed": c.seed,
        "step_count": c.step_count,
        "best": c.best,
        "spacing": None if c.neighbours is None else c.neighbours.spacing,
        "kind": [kind.motion, kind.fourier_order, kind.sh_degree],
        "sampler": {key: c.sampler[key] for key in ("position", "generator")},
    }
    with atomic_file(path) as temporary:
        try:
            tensors = {name: tensor.cpu() for name, tensor in tensors.items()}
            # A single metadata key, because safetensors writes several keys in random order.
            save_file(tensors, temporary, metadata={"state": json.dumps(header, sort_keys=True)})
        except SafetensorError as error:
            raise _os_error(error) from error


def load(path: Path) -> Checkpoint:
    """Raises DataError, a ValueError of one line with the file's name, for anything but a valid checkpoint."""
    header, tensors = _read(path)
    if header.get("version") != VERSION:
        raise DataError(path, f"checkpoint version {VERSION}", str(header.get("version")))
    with _naming(path):
        return _assemble(header, tensors)


def load_model(path: Path) -> Model:
    """Only the model of a checkpoint, in rotations; Adam's moments are not read."""
    header, tensors = _read(path, lambda name: name.startswith("model."))
    state = {name.removeprefix("model."): tensor for name, tensor in tensors.items()}
    with _naming(path):
        return in_rotations(_model(header, state))


def _assemble(header: dict, tensors: dict[str, Tensor]) -> Checkpoint:
    """Every part is validated here, so that an invalid one does not stop a resumed run hours later."""
    groups: dict[str, dict[str, Tensor]] = {}
    for name, tensor in tensors.items():
        group, _, rest = name.partition(".")
        groups.setdefault(group, {})[rest] = tensor
    model = _model(header, groups["model"])
    rows = {name: p.shape for name, p in model.parameters.items()}
    moments = (groups["first"], groups["second"])
    for moment in moments:
        _require_floats(moment, rows)
    shared_moments = {}
    for name, tensor in shared_tensors(model).items():
        _require_floats(groups[name], dict.fromkeys(("first", "second"), tensor.shape))
        shared_moments[name] = (groups[name]["first"], groups[name]["second"])
    _require_floats(groups["statistics"], dict.fromkeys(Statistics.FIELDS, torch.Size([len(model)])))
    sampler = dict(header["sampler"], order=tensors["sampler.order"].numpy())
    order = sampler["order"]
    if order.dtype != np.int64 or not np.array_equal(np.sort(order), np.arange(order.size)):
        raise ValueError("sampler.order: expected a permutation")
    _integer("sampler.position", sampler["position"], len(order))
    np.random.default_rng().bit_generator.state = json.loads(sampler["generator"])
    torch.Generator().set_state(tensors["split_generator"])
    best = header["best"]
    if best is not None:
        _number("best.psnr", best["psnr"])
        _integer("best.iteration", best["iteration"])
    return Checkpoint(
        iteration=_integer("iteration", header["iteration"]),
        spent=Spent(*(_number(name, header[name]) for name in ("train_seconds", "cpu_seconds"))),
        seed=_integer("seed", header["seed"], MAX_SEED),
        model=model,
        step_count=_integer("step_count", header["step_count"]),
        moments=moments,
        shared_moments=shared_moments,
        statistics=groups["statistics"],
        sampler=sampler,
        split_rng=tensors["split_generator"],
        best=best,
        best_model=_model(header, groups["best"]) if "best" in groups else None,
        neighbours=_neighbours(header, tensors, len(model)),
    )


def _neighbours(header: dict, tensors: dict[str, Tensor], count: int) -> Neighbours | None:
    if (index := tensors.get("neighbours")) is None:
        return None
    if len(index) != count:
        raise ValueError(f"neighbours: expected those of {count} Gaussians, found {len(index)}")
    return Neighbours(index, _number("spacing", header["spacing"]))


def _model(header: dict, state: dict[str, Tensor]) -> Model:
    motion, fourier_order, sh_degree = header["kind"]
    if motion not in get_args(Motion):
        raise ValueError(f"kind: expected one of {', '.join(get_args(Motion))}, found {motion!r}")
    _integer("kind: Fourier order", fourier_order, 0 if motion == "static" else MAX_FOURIER_ORDER)
    _integer("kind: SH degree", sh_degree, max(SH_DEGREES.values()))
    trajectories = state["trajectories"].shape[1] if "trajectories" in state else 0
    return Model.restored(ModelKind(motion, fourier_order, sh_degree, trajectories), state).checked()


def _require_floats(tensors: dict[str, Tensor], shapes: Mapping[str, torch.Size | None]) -> None:
    """ValueError unless the tensors are finite float32 of exactly these names and shapes."""
    for name in {**shapes, **tensors}:
        found = tensors.get(name)
        if found is None or found.dtype != torch.float32 or found.shape != shapes.get(name):
            raise ValueError(
                f"{name}: expected float32 {list(shapes.get(name) or [])}, found "
                f"{found if found is None else (found.dtype, list(found.shape))}"
            )
        if not torch.isfinite(found.sum(dtype=torch.float64)):
            raise ValueError(f"{name}: NaN or Inf")


def _integer(name: str, value: object, largest: int = 2**53) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= largest:
        raise ValueError(f"{name}: expected an integer in 0..{largest}, found {value!r}")
    return value


def _number(name: str, value: object) -> float:
    if not isinstance(value, (int, float)) or isinstance(value, bool) or not math.isfinite(value):
        raise ValueError(f"{name}: expected a finite number, found {value!r}")
    return value


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Turns the errors of invalid parts of a checkpoint into a DataError with its name."""
    try:
        yield
    except (KeyError, IndexError, TypeError, AttributeError, ValueError, ArithmeticError, RuntimeError) as error:
        what = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise DataError(path, "a checkpoint of this program", what) from None


def _read(path: Path, wanted: Callable[[str], bool] = lambda name: True) -> tuple[dict, dict[str, Tensor]]:
    """The header, and the tensors that `wanted` selects by name."""
    try:
        with safe_open(path, framework="pt") as file:
            header = json.loads((file.metadata() or {})["state"])
            names = filter(wanted, file.keys())
            tensors = {name: file.get_tensor(name) for name in names}
    except FileNotFoundError:
        raise
    except Exception as error:  # safetensors, json and torch raise many types for broken files
        raise DataError(path, "a checkpoint of this program", str(error)) from None
    if not isinstance(header, dict):
        raise DataError(path, "a checkpoint of this program", f"a header that is a {type(header).__name__}")
    return header, tensors


def _os_error(error: SafetensorError) -> OSError:
    """The operating system's error, which safetensors reports as text: "… (os error 28)"."""
    code = re.search(r"os error (\d+)", str(error))
    return OSError(int(code[1]), os.strerror(int(code[1]))) if code else OSError(str(error))


def saved_iteration(path: Path) -> int:
    """The last completed iteration of a checkpoint, from its header alone."""
    return _integer("iteration", _read(path, wanted=lambda name: False)[0].get("iteration"))
