"""A run: reads the scene, settles the configuration, and goes through the stages that are not done yet."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

from datasets.files.atomic_write import write_json
from datasets.files.errors import read_json
from datasets.manifest import AS_PUBLISHED, recorded
from pipeline.config.compose import Command
from pipeline.config.schema import Config
from pipeline.data.prepare import prepare
from pipeline.evaluation.evaluate import refuse_small_images
from pipeline.evaluation.lpips import refuse_wrong_weights
from pipeline.runs.provenance import git_commit, provenance
from pipeline.runs.run_folder import RunFolder
from pipeline.runs.run_identity import read_stages, refuse_foreign, refuse_other_run
from pipeline.stages.estimate import estimate_if_large, training_minutes
from pipeline.stages.inputs import code_hash, config_hash, data_hash
from pipeline.stages.settle import for_scene, scaling
from pipeline.stages.stages import NAMES, STAGES, Job, Stage
from pipeline.training import checkpoint as checkpoints
from pipeline.training.sampling import refuse_large_batch
from rasterizer.engine import device_of

NOTHING_KEPT = "nothing of the run was saved yet; the same command starts it anew"
# Keys that the data and validation settle, which the first look at a run folder cannot know.
OPEN = ("train", "ablation.static", "ablation.fourier_order", "init.source", "scene.background", "scene.reader",
        "scene.test_split", "scene.validation_every", "scene.downscale", "scene.color_correction")  # fmt: skip
AFTER_TRAINING = ("evaluate", "page")


def run(command: Command, log: Callable[[str], None]) -> dict | None:
    """The stages of one run; returns the contents of its metrics.json, None where `until` or `only` stops before it.

    log: takes a line of text for the user. Errors are one line.
    """
    cfg = command.config()
    path, chosen = Path(cfg.out), chosen_stages(cfg)
    device_of(cfg.backend)  # before anything else, where there is no GPU
    refuse_foreign(path)  # before anything is written: a refused run leaves no folder behind
    if cfg.resume:
        refuse_other_run(path, asdict(cfg), ignored=OPEN)
    trained = cfg.resume and "values" in read_stages(path).get("train", {})
    if not trained and (needs := estimate_if_large(cfg, log)):
        for line in needs.lines(cfg):
            log(line)
    data = prepare(cfg, log)
    cfg = for_scene(command, data)
    if cfg.evaluate.lpips:
        refuse_wrong_weights(cfg.evaluate.lpips_weights)
    refuse_small_images(data.scene, cfg.train.resolution_scale)  # before hours of training
    refuse_large_batch(len(data.scene.train), cfg.train.batch)
    published = recorded(cfg.scene.name, data.scene.source)
    if published and not published["found"].startswith(AS_PUBLISHED):
        log(f"{data.scene.source}: not the data of the manifest {published['manifest']}: {published['found']}")
    if data.poses_estimated and not trained:
        log(training_minutes(cfg, data.scene))

    with RunFolder(path, cfg.resume) as folder:
        folder.claim(asdict(for_scene(command, data, folder.values_of("settle").get("decided", {}))))
        _go_through(Job(command, cfg, data, folder, log), chosen)
        if not {"evaluate", "page"} & set(chosen):
            return None
        metrics = read_json(folder.metrics)
    if metrics.get("outlook"):
        log(metrics["outlook"])
    return metrics


def chosen_stages(cfg: Config) -> list[str]:
    """The stages that `until` and `only` ask for, in order; ValueError for names that no stage has."""
    wanted = [cfg.only] if isinstance(cfg.only, str) else list(cfg.only)
    for key, names in (("until", [cfg.until] if cfg.until else []), ("only", wanted)):
        for name in names:
            if name not in NAMES:
                raise ValueError(f"{key}: expected {', '.join(NAMES)}, found {name!r}")
    if wanted and cfg.until:
        raise ValueError(f"until: expected nothing beside only=[{','.join(wanted)}], found {cfg.until!r}")
    if wanted and not cfg.resume and NAMES[0] not in wanted:
        listed = ",".join(wanted)
        raise ValueError(f"resume: expected true beside only=[{listed}], which keeps earlier stages, found false")
    return wanted or list(NAMES[: NAMES.index(cfg.until) + 1] if cfg.until else NAMES)


def _go_through(job: Job, chosen: list[str]) -> None:
    """Does the chosen stages that are not done with this configuration, these data and this code."""
    folder, log = job.folder, job.log
    data, commit = data_hash(job.data), git_commit()
    code: tuple[str, ...] = ()
    settled: dict = {}
    if folder.data not in (None, data):
        raise ValueError(
            f"{folder.path}: holds a run made from other data than {job.data.scene.source} holds now, or normalised "
            "otherwise; give another out=DIR, or resume=false to replace it"
        )
    last = max(NAMES.index(name) for name in chosen)
    for stage in STAGES[: last + 1]:
        code += stage.code
        inputs = {"data": data, "config": config_hash(job.cfg, stage.name), "code": code_hash(code)}
        state, made_by = folder.state(stage.name, inputs)
        if stage.name not in chosen:
            if state == "open":
                raise ValueError(f"{stage.name}: not done in {folder.path}; until={stage.name} does it")
            if state == "other code":
                log(f"{stage.name}: kept, though other code made it (commit {made_by})")
        elif state == "done":
            log(f"{stage.name}: already done in {folder.path}")
        else:
            if state == "other code":
                log(f"{stage.name}: other code made it (commit {made_by}); made again")
            log(f"{stage.name}: {folder.path}")
            if stage.name == "train" and (line := scaling(job.command, job.data.scene, settled)):
                log(line)
            _do(stage, job, inputs, commit)
        if stage.name == "settle":
            settled = folder.values_of("settle")["decided"]
            job = replace(job, cfg=for_scene(job.command, job.data, settled))
            folder.write_config(asdict(job.cfg))


def _do(stage: Stage, job: Job, inputs: dict[str, str], commit: str) -> None:
    folder, command = job.folder, shlex.join(["python", "-m", "pipeline", *job.command.overrides])
    later = [name for other in STAGES[NAMES.index(stage.name) :] for name in other.outputs]
    if folder.begin(stage.name, inputs, later):
        job.log(f"{stage.name}: what other code had begun is made anew")
    if stage.name not in AFTER_TRAINING:  # provenance describes the training run; a new evaluation does not replace it
        write_json(folder.provenance, provenance(command, job.cfg.backend))
    folder.log({"event": f"start {stage.name}", "command": command})
    folder.finish(stage.name, inputs, commit, stage.outputs, stage.run(job))
    folder.log({"event": f"finished {stage.name}"})


def kept_progress(cfg: Config) -> str:
    """After an interruption: what the run folder holds, and how to continue."""
    path, command = Path(cfg.out), "the same command" if cfg.resume else "the same command without resume=false"
    try:
        done = [name for name, record in read_stages(path).items() if "values" in record]
        checkpoint = path / checkpoints.FILE_NAME
        if "train" in done:
            return f"training is finished and kept; {command} goes on after it"
        if checkpoint.exists():
            return f"{command} goes on from iteration {checkpoints.saved_iteration(checkpoint)}"
        if done:
            return f"{', '.join(done)} kept, no iteration of training yet; {command} goes on from there"
    except (ValueError, OSError):
        pass
    return NOTHING_KEPT
