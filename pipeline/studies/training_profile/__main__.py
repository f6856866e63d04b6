"""Training profile: where the CPU seconds of a training go, by stage.

Trains as `python -m pipeline key=value …` does, on one thread, into a folder that is removed again. Writes
training_profile.md and .csv, a line a stage. Evaluation and the reading of the scene are not training and not counted.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import wraps
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import torch

from pipeline.config.compose import command_of
from pipeline.runs.run_folder import csv_text
from pipeline.stages import stages
from pipeline.stages.run import run
from pipeline.studies.common import StudyParser, made_by, markdown_table, write_results
from pipeline.studies.training_profile.stage_clock import StageClock
from pipeline.terminal.command_line import command, log
from pipeline.training import finite_checks, loop, optimiser, state
from pipeline.training.density.statistics import Statistics
from pipeline.training.objective import image_terms, released_rigid, rigid_neighbours, transparency
from pipeline.training.optimiser import Adam
from pipeline.training.state import TrainState
from rasterizer.cores import keep_freed_memory
from rasterizer.rasterizer import STAGES, Rasterizer

NAME = "training_profile"
REST = "the rest of the loop"
SETTLE, EVALUATION, REPORTS = "short trainings of validation", "evaluation", "reports"
# What is timed, and the stage that it counts for. Kernel stages come with `timing_kernel`.
TIMED: Sequence[tuple[Any, str, str]] = (
    (loop, "draw_batch", "targets and jitter"),
    (image_terms.Photometric, "__call__", "photometric loss"),
    (image_terms.Flow, "__call__", "other losses"),
    (image_terms.KnownDepth, "__call__", "other losses"),
    (image_terms.Sky, "__call__", "other losses"),
    (rigid_neighbours.RigidNeighbours, "add", "other losses"),
    (state, "find_neighbours", "other losses"),
    (released_rigid.ReleasedRigid, "add", "other losses"),
    (transparency.Transparency, "add", "other losses"),
    (TrainState, "zero_gradients", "gradients zeroed and checked"),
    (finite_checks, "check_gradients", "gradients zeroed and checked"),
    (Statistics, "begin", "densification statistics"),
    (Statistics, "add_view", "densification statistics"),
    (Statistics, "end", "densification statistics"),
    (optimiser, "sh_adam_step", "Adam, SH coefficients"),
    (Adam, "step", "Adam, other parameters"),
    (loop, "train", REST),
)
WHOLE: Sequence[tuple[Any, str, str]] = (
    (stages, "decide", SETTLE),
    (loop, "_evaluate", EVALUATION),
    (loop, "_report", REPORTS),
    (loop, "save", "checkpoints"),
)
NOT_TRAINING = (EVALUATION, REPORTS)
HEADER = ("stage", "CPU s", "share")


@contextmanager
def timing_kernel(clock: StageClock) -> Iterator[None]:
    """Splits the kernel's two calls by its own stage times, which on one thread are CPU time but for interruptions."""
    passes = {"render_batch": (staticmethod, STAGES[:4]), "backward": (lambda function: function, STAGES[4:])}
    with ExitStack() as stack:
        for function, (bound, names) in passes.items():
            timed = _timed_pass(clock, getattr(Rasterizer, function), names)
            stack.enter_context(patch.object(Rasterizer, function, bound(timed)))
        yield


def _timed_pass(clock: StageClock, original: Any, names: Sequence[str]) -> Any:
    around = "around the kernel"

    @wraps(original)
    def timed(rasterizers: Rasterizer | Sequence[Rasterizer], *args: Any, **kwargs: Any) -> Any:
        before = clock.seconds[around]
        with clock.stage(around):
            result = original(rasterizers, *args, **kwargs)
        spent = clock.seconds[around] - before
        each = [rasterizers] if isinstance(rasterizers, Rasterizer) else rasterizers
        ms = {name: sum(rasterizer.stage_ms[name] for rasterizer in each) for name in names}
        scale = min(1e-3, spent / max(1e-9, sum(ms.values())))
        if spent > 0:
            clock.move(around, {name: scale * ms[name] for name in names})
        return result

    return timed


def profile(keys: Sequence[str]) -> dict[str, float]:
    """CPU seconds by stage of the training with these `key=value`, the largest first."""
    clock = StageClock()
    with TemporaryDirectory() as folder, ExitStack() as stack:
        order, _ = command_of([*keys, "threads=1", "until=train", f"out={folder}/run"])
        for owner, function, name in TIMED:
            stack.enter_context(clock.timing(owner, function, name))
        for owner, function, name in WHOLE:
            stack.enter_context(clock.timing(owner, function, name, whole=True))
        stack.enter_context(patch.object(stages, "train", loop.train))
        stack.enter_context(patch.object(loop, "refine", _timed_refine(clock, loop.refine)))
        stack.enter_context(timing_kernel(clock))
        run(order, log)
    found = {name: seconds for name, seconds in clock.seconds.items() if name not in NOT_TRAINING}
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def _timed_refine(clock: StageClock, original: Any) -> Any:
    """refine() is a generator: what it does is timed, not its creation."""

    @wraps(original)
    def timed(*args: Any) -> list:
        with clock.stage("densification and pruning", whole=True):
            return list(original(*args))

    return timed


def markdown(seconds: dict[str, float], heading: str) -> str:
    total = sum(seconds.values())
    rows = [[name, f"{value:.1f}", f"{value / total:.1%}"] for name, value in seconds.items()]
    table = markdown_table(HEADER, [*rows, ["all", f"{total:.1f}", "100 %"]])
    return f"### Where the CPU seconds of a training go\n\n{heading}\n\n{table}\n"


@command
def main(arguments: list[str]) -> int:
    parser = StudyParser(NAME, __doc__)
    parser.add_argument("keys", nargs="+", metavar="KEY=VALUE", help="of python -m pipeline: scene, train, …")
    options = parser.parse_args(arguments)
    keep_freed_memory()
    torch.set_num_threads(1)
    seconds = profile(options.keys)
    csv = csv_text(["stage", "seconds"], [[name, round(value, 3)] for name, value in seconds.items()])
    write_results(options.out, NAME, markdown(seconds, made_by(NAME, arguments)), {"csv": csv})
    return 0


if __name__ == "__main__":
    sys.exit(main())
