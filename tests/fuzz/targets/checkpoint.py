"""Target checkpoint.safetensors (pipeline/training/checkpoint.py): the checkpoint, and its model alone."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import numpy as np
import torch
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn, SearchStrategy

from fuzz.edits.arrays import join_header, split_header
from fuzz.edits.bytes import changed_files, edit_bytes
from fuzz.edits.json import edit_tree
from fuzz.model_checks import check_model, random_model
from fuzz.target import Changes, Files, Target, require, valid_or_refused
from pipeline.model.environment_map import EnvironmentMap
from pipeline.training import checkpoint
from pipeline.training.density.statistics import Statistics
from pipeline.training.objective.neighbours import Neighbours
from pipeline.training.reporting import Spent

ROWS = 3
KEYS = ("iteration", "seed", "step_count")


def example() -> Files:
    model, best = random_model("full", 1, 1, ROWS, 0), random_model("full", 1, 1, ROWS, 1)
    for each in (model, best):
        each.sphere, each.environment_map = torch.arange(ROWS) == 1, EnvironmentMap(torch.full((3, 2, 4), 0.25))
    moments = tuple({name: torch.full_like(p, 0.5) for name, p in model.parameters.items()} for _ in range(2))
    saved = checkpoint.Checkpoint(
        iteration=7,
        spent=Spent(1.5, 3.0),
        seed=0,
        model=model,
        step_count=7,
        moments=moments,
        shared_moments={"environment": (torch.zeros(3, 2, 4), torch.ones(3, 2, 4))},
        statistics={name: torch.ones(ROWS) for name in Statistics.FIELDS},
        sampler={
            "order": np.array([2, 0, 1]),
            "position": 1,
            "generator": json.dumps(np.random.default_rng(0).bit_generator.state),
        },
        split_rng=torch.Generator().manual_seed(0).get_state(),
        best={"psnr": 20.0, "iteration": 5},
        best_model=best,
        neighbours=Neighbours(torch.zeros(ROWS, 8, dtype=torch.int32), 0.1),
    )
    with tempfile.TemporaryDirectory() as temporary:
        path = Path(temporary) / checkpoint.FILE_NAME
        checkpoint.save(path, saved)
        return {checkpoint.FILE_NAME: path.read_bytes()}


def edit_checkpoint(draw: DrawFn, content: bytes) -> bytes:
    """Changes the header, the JSON state within it, or the data."""
    header, behind = split_header(content)
    kind = draw(st.sampled_from(("tensors", "state", "values")))
    if kind == "values":
        return content[: -len(behind)] + edit_bytes(draw, behind)
    if kind == "tensors":
        return join_header(edit_tree(draw, header), behind)
    state = edit_tree(draw, json.loads(header["__metadata__"]["state"]))
    return join_header(json.dumps({**header, "__metadata__": {"state": state}}), behind)


def changes(files: Files) -> SearchStrategy[Changes]:
    return changed_files(files, {".safetensors": edit_checkpoint})


def check(folder: Path) -> str:
    path = folder / checkpoint.FILE_NAME
    if not path.exists():
        return "absent"  # callers check that it exists
    with valid_or_refused(folder):
        check_model(checkpoint.load_model(path))
    with valid_or_refused(folder) as outcome:
        found = checkpoint.load(path)
        check_model(found.model)
        count = len(found.model)
        require(
            all(
                isinstance(getattr(found, key), (int, float)) and 0 <= abs(getattr(found, key)) < 1e300 for key in KEYS
            ),
            "an iteration, time, seed or step that is no number",
        )
        for moments in found.moments:
            require(
                {name: (m.shape, m.dtype) for name, m in moments.items()}
                == {name: (p.shape, p.dtype) for name, p in found.model.parameters.items()},
                "moments of another",
            )
        statistics = Statistics.restored(found.statistics).state()
        require(all(statistics[name].shape == (count,) for name in Statistics.FIELDS), "statistics of another model")
        torch.Generator().set_state(found.split_rng)
        np.random.default_rng().bit_generator.state = json.loads(found.sampler["generator"])
        require(sorted(found.sampler["order"].tolist()) == list(range(len(found.sampler["order"]))), "no permutation")
        if found.best is not None:
            require(found.best["psnr"] + found.best["iteration"] < 1e300, f"the best {found.best}")
        if found.best_model is not None:
            check_model(found.best_model)
    return outcome[0]


TARGET = Target("checkpoint", "checkpoint.safetensors", example, changes, check)
