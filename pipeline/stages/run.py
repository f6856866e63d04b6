"""A run: prepares the scene and goes through the stages that are not done yet."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from omegaconf.errors import OmegaConfBaseException

from datasets import Scene
from datasets.files.atomic_write import write_json
from datasets.files.errors import read_json
from pipeline.config.compose import config_of_tree
from pipeline.config.scene_overrides import with_overrides
from pipeline.config.schema import Config
from pipeline.data.prepare import prepare
from pipeline.evaluation.evaluate import refuse_small_images
from pipeline.model.scene_settings import overrides_for, resolved
from pipeline.runs.provenance import provenance
from pipeline.runs.run_folder import RunFolder
from pipeline.runs.run_identity import read_stages, refuse_foreign, refuse_other_run
from pipeline.stages.decisions import MOTION, TIME_COLOUR, decide_motion, decide_time_colour
from pipeline.stages.estimate import estimate_if_large, training_minutes
from pipeline.stages.evaluation import evaluate_model
from pipeline.stages.initial_model import make_initial_model
from pipeline.stages.inputs import stage_inputs
from pipeline.stages.points import copy_points
from pipeline.stages.stage import Log, Stage
from pipeline.stages.training import train_model
from pipeline.stages.viewing import write_page
from pipeline.training import checkpoint as checkpoints
from pipeline.training.sampling import refuse_large_batch

# In this order. stage_inputs says which of them a run has.
STAGES = (
    Stage("sfm", copy_points, ("sfm", "sfm_picture")),
    Stage(MOTION, decide_motion),
    Stage(TIME_COLOUR, decide_time_colour),
    Stage("init", make_initial_model, ("init_ply",)),
    Stage("train", train_model, ("checkpoint", "curve")),
    Stage("evaluate", evaluate_model, ("metrics", "per_image", "renders")),
    Stage("view", write_page, ("viewer",)),
)
KINDS = {
    "static_overrides": "static scene",
    "multi_view_overrides": "several cameras",
    "clip_overrides": "clip by one camera",
}
NOTHING_KEPT = "nothing of the run was saved yet; the same command starts it anew"


def run(cfg: Config, overrides: Sequence[str], log: Log) -> dict:
    """All stages of one run; returns the contents of its metrics.json. Errors are one line.

    overrides: of the command line, for the record. log: takes a line of text for the user.
    """
    path = Path(cfg.out)
    refuse_foreign(path)  # before anything is written: a refused run leaves no folder behind
    if cfg.resume:
        refuse_other_run(
            path, asdict(cfg), _with_defaults, ignored=("train", "scene.background")
        )  # resolved below, by the scene
    if not (cfg.resume and "train" in read_stages(path)) and (needs := estimate_if_large(cfg, log)):
        for line in needs.lines(cfg):
            log(line)
    data = prepare(cfg, log)
    unresolved, cfg = cfg, resolved(cfg, data.scene)
    refuse_small_images(data.scene, cfg.train.resolution_scale)  # before hours of training
    refuse_large_batch(len(data.scene.train), cfg.train.sampler, cfg.train.batch)
    if data.poses_estimated and not (cfg.resume and "train" in read_stages(path)):
        log(training_minutes(cfg, data.scene))
    group = overrides_for(data.scene, cfg)
    if group and with_overrides(cfg, None).train != with_overrides(unresolved, None).train:
        log(f"{KINDS[group]}: trained with train.{group}, whose keys count instead of the schedule's")

    with RunFolder(path, asdict(cfg), cfg.resume, lambda stored: _resolved_tree(stored, data.scene)) as folder:
        inputs = stage_inputs(cfg, data)
        if folder.inputs_of("init") not in (None, inputs["init"]):
            raise ValueError(
                f"{folder.path}: holds a run made from other data than {data.scene.source} holds now, or "
                "normalised otherwise; give another out=DIR, or resume=false to replace it"
            )
        stages = [stage for stage in STAGES if stage.name in inputs]
        if not all(stage.is_done(folder, inputs[stage.name]) for stage in stages):
            command = shlex.join(["python", "-m", "pipeline", *overrides])
            # Of what trained the model, which a later evaluation leaves as it is.
            if any(stage.name == "train" and not stage.is_done(folder, inputs["train"]) for stage in stages):
                write_json(folder.provenance, {**provenance(command), "overrides": list(overrides)})
            folder.log({"event": "start", "command": command})
        for stage in stages:
            if stage.is_done(folder, inputs[stage.name]):
                log(f"{stage.name}: already done in {folder.path}")
                continue
            log(f"{stage.name}: {folder.path}")
            folder.finish(stage.name, inputs[stage.name], **stage.run(cfg, data, folder, log))
            folder.log({"event": f"finished {stage.name}"})
        metrics = read_json(folder.metrics)
        if metrics.get("outlook"):
            log(metrics["outlook"])
        return metrics


def kept_progress(cfg: Config) -> str:
    """After an interruption: what the run folder holds, and how to continue."""
    path, command = Path(cfg.out), "the same command" if cfg.resume else "the same command without resume=false"
    try:
        stages, checkpoint = read_stages(path), path / checkpoints.FILE_NAME
        if "train" in stages:
            return f"training is finished and kept; {command} goes on after it"
        if checkpoint.exists():
            return f"{command} goes on from iteration {checkpoints.saved_iteration(checkpoint)}"
        if stages:
            return f"{', '.join(stages)} kept, no iteration of training yet; {command} goes on from there"
    except (ValueError, OSError):
        pass
    return NOTHING_KEPT


def _with_defaults(stored: dict) -> dict:
    """A run's config.yaml, with the defaults of keys that were added since; unchanged where the schema refuses it."""
    try:
        return asdict(config_of_tree(stored))
    except (ValueError, OmegaConfBaseException):
        return stored


def _resolved_tree(stored: dict, scene: Scene) -> dict:
    """A run's config.yaml, resolved for the scene; unchanged where today's schema does not read it."""
    try:
        return asdict(resolved(config_of_tree(stored), scene))
    except (ValueError, OmegaConfBaseException):
        return stored
