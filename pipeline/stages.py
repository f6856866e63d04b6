"""The stages of a run: (sfm → select_motion → select_time_colour →) init → train → evaluate → view.

A stage with unchanged inputs is skipped. Its inputs are what its result depends on: the stage before it, the data, and
its part of the configuration.
"""

from __future__ import annotations

import hashlib
import json
import shlex
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

import numpy as np
from omegaconf.errors import OmegaConfBaseException

from datasets import Scene
from datasets.files.atomic_write import atomic_file, write_json
from datasets.files.errors import read_json
from pipeline.config.compose import config_of_tree
from pipeline.config.random_streams import Stream, stream
from pipeline.config.renamed_keys import with_first_names
from pipeline.config.schema import Config
from pipeline.config.static_overrides import without_static_overrides
from pipeline.data.prepare import Prepared, prepare
from pipeline.evaluation.evaluate import Evaluation, evaluate, evaluate_with_images
from pipeline.evaluation.lifetimes import lifetimes
from pipeline.evaluation.motion.moving_pixels import MovingPixels
from pipeline.evaluation.outlook import outlook, path_angles
from pipeline.evaluation.quick_evaluate import quick_evaluate
from pipeline.model.initialise import initialise
from pipeline.model.model import Model
from pipeline.model.ply import load_ply, save_ply
from pipeline.model.scene_settings import resolved
from pipeline.runs.provenance import peak_memory_mb, provenance, reset_peak_memory
from pipeline.runs.run_folder import RunFolder, now, write_csv
from pipeline.runs.run_identity import read_stages, refuse_foreign, refuse_other_run
from pipeline.training import checkpoint as checkpoints
from pipeline.training import select_time_colour
from pipeline.training.estimate import estimate_if_large, training_minutes
from pipeline.training.loop import Progress, TrainResult, train
from pipeline.training.selection import motion
from pipeline.view.live.address import address_of
from pipeline.view.live.feed import Feed
from pipeline.view.live.server import LiveServer
from pipeline.view.live.training_view import TrainingView
from pipeline.view.viewer import Shown, live_page, write_viewer
from rasterizer import Rasterizer
from rasterizer.cores import thread_count

Log = Callable[[str], None]

SELECTION = "select_time_colour"  # the stage, and what metrics.json has of it
MOTION = "select_motion"  # likewise
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
    if data.is_clip and not (cfg.resume and "train" in read_stages(path)):
        log(training_minutes(cfg, data.scene))
    if unresolved.train.static_overrides and cfg.train != without_static_overrides(unresolved).train:
        log("static scene: trained with train.static_overrides")

    with RunFolder(path, asdict(cfg), cfg.resume, lambda stored: _resolved_tree(stored, data.scene)) as folder:
        inputs = stage_inputs(cfg, data)
        if folder.inputs_of("init") not in (None, inputs["init"]):
            raise ValueError(
                f"{folder.path}: holds a run made from other data than {data.scene.source} holds now, or "
                "normalised otherwise; give another out=DIR, or resume=false to replace it"
            )
        if not all(_done(folder, stage, inputs[stage]) for stage in inputs):
            command = shlex.join(["python", "-m", "pipeline", *overrides])
            write_json(folder.provenance, {**provenance(command), "overrides": list(overrides)})
            folder.log({"event": "start", "command": command})
        for stage in inputs:
            if _done(folder, stage, inputs[stage]):
                log(f"{stage}: already done in {folder.path}")
                continue
            log(f"{stage}: {folder.path}")
            folder.finish(stage, inputs[stage], **_RUN[stage](cfg, data, folder, log))
            folder.log({"event": f"finished {stage}"})
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


def stage_inputs(cfg: Config, data: Prepared) -> dict[str, str]:
    """Stage -> hash of everything its result depends on, for the stages that this run has.

    Keys are hashed under their first names, so that a renamed key does not make a finished stage count as undone.
    """
    config, found = with_first_names(asdict(cfg)), {}
    initial = {key: value for key, value in config["train"].items() if key.startswith("init_")}
    beginning = [fingerprint(data.scene), config["ablation"], initial, config["scene"]["init_points"], cfg.seed]
    if not data.canonical.is_identity:  # a model must not continue in other coordinates
        beginning.append(asdict(data.canonical))
    if data.cloud is not None and data.sfm_folder is None:  # points that came with the data
        beginning.append(_digest(data.cloud.points, data.cloud.colors))
    if data.sfm_folder is not None:
        found["sfm"] = _hash(data.sfm_folder.name)
        beginning.append(found["sfm"])
    if data.scene.is_drive:
        beginning += [asdict(cfg.init), cfg.effective_fourier_order, config["train"]["densify"]["max_gaussians"]]
    if cfg.effective_background_model != "none":
        beginning += [cfg.effective_background_model, cfg.init.sphere_points, cfg.init.sphere_radius]
    if motion.due(cfg, data.scene):
        found[MOTION] = _hash("motion", *beginning, config["train"], config["scene"]["near"])
        beginning.append(found[MOTION])
    if select_time_colour.due(cfg, data.scene):
        found[SELECTION] = _hash(*beginning, config["train"], config["scene"]["near"])
        beginning.append(found[SELECTION])
    found["init"] = _hash(*beginning)
    found["train"] = _hash(found["init"], config["train"], config["scene"]["near"])
    found["evaluate"] = _hash(found["train"], config["evaluate"])
    found["view"] = _hash(found["evaluate"])
    return found


def fingerprint(scene: Scene) -> str:
    """Hash of a scene's images, masks, cameras, sweeps, times and bounds. Its folder does not matter."""
    digest = hashlib.blake2b(digest_size=16)
    digest.update(repr((scene.duration, scene.time_start, scene.background, scene.init_box)).encode())
    for view in scene.train + scene.test:
        c = view.camera
        digest.update(repr((view.name, view.time, c.width, c.height, c.fx, c.fy, c.cx, c.cy)).encode())
        digest.update(c.world_to_cam.tobytes())
        # A stored frame knows its checksum: a scene of 25 GB need not be read for this.
        known = getattr(view.image, "checksum", None)
        digest.update(np.ascontiguousarray(view.image).data if known is None else known.encode())
        for plane in (view.coverage, view.mask):
            if plane is not None:
                digest.update(np.ascontiguousarray(plane).data)
        for mask in (view.sky, view.moving):
            if mask is not None:
                digest.update(np.packbits(mask).data)
    for sweep in scene.sweeps + scene.test_sweeps:
        digest.update(repr((sweep.frame, sweep.time)).encode())
        digest.update(np.ascontiguousarray(sweep.points).data)
    return digest.hexdigest()


def _sfm(cfg: Config, data: Prepared, folder: RunFolder, log: Log) -> dict:
    """cached structure from motion → sfm.json, sfm.png."""
    assert data.cloud is not None and data.sfm_folder is not None, "this stage is due only where there are points"
    for path in (folder.sfm, folder.sfm_picture):
        with atomic_file(path) as temporary:
            shutil.copyfile(data.sfm_folder / path.name, temporary)
    return data.cloud.summary()


def _select_motion(cfg: Config, data: Prepared, folder: RunFolder, log: Log) -> dict:
    """scene and points → whether the model has time at all."""
    selection = motion.select_motion(data.scene, cfg, data.cloud, thread_count(cfg.threads), log)
    log(f"{MOTION}: {selection}")
    return asdict(selection)


def _select_time_colour(cfg: Config, data: Prepared, folder: RunFolder, log: Log) -> dict:
    """scene and points → whether the model has time-varying colour; nothing where it has no time."""
    if (decided := _motion(folder)) and not decided.dynamic:
        return {}
    selection = select_time_colour.select(data.scene, cfg, data.cloud, thread_count(cfg.threads), log)
    log(f"{SELECTION}: {selection}")
    return asdict(selection)


def _init(cfg: Config, data: Prepared, folder: RunFolder, log: Log) -> dict:
    """scene and points → init.ply; and in canonical.json how its coordinates come from the files'."""
    cfg = _as_decided(cfg, data, folder)
    if (selection := _selection(folder)) and not selection.kept:
        cfg = select_time_colour.without_time_colour(cfg)
    model = initialise(data.scene, cfg, stream(cfg.seed, Stream.INIT), data.cloud)
    with atomic_file(folder.init_ply) as temporary:
        save_ply(temporary, model)
    if not data.canonical.is_identity:
        write_json(folder.canonical, data.canonical.to_dict())
    return {"n_gaussians": len(model)}


def _train(cfg: Config, data: Prepared, folder: RunFolder, log: Log) -> dict:
    """init.ply → checkpoint.safetensors, error_vs_time.csv; goes on from the checkpoint if there is one.

    The seconds of select_motion and select_time_colour count as training.
    """
    scene, cfg = data.scene, _as_decided(cfg, data, folder)
    rasterizer = Rasterizer(threads=thread_count(cfg.threads))
    moving = MovingPixels(scene, cfg.train.resolution_scale)

    def evaluate_fn(model: Model, progress: Progress) -> dict:
        found = quick_evaluate(model, scene, cfg, rasterizer, moving)
        folder.log(
            {
                "event": "evaluate",
                "iteration": progress.iteration,
                **found,
                "lifetimes": lifetimes(model, scene),
                "peak_rss_mb": peak_memory_mb(),
            }
        )
        if watcher is not None:
            watcher.held_out = found["psnr"]
        return found

    reset_peak_memory()
    decisions = [decision.seconds for decision in (_motion(folder), _selection(folder)) if decision]
    with _live_view(cfg, scene, log) as watcher:
        result = train(
            load_ply(folder.init_ply), scene, cfg, folder, evaluate_fn, start_seconds=sum(decisions), watcher=watcher
        )
        if watcher is not None:
            watcher.see_last(result.model, result.iteration)
    return {
        "iterations": result.iteration,
        "train_seconds": result.train_seconds,
        "n_gaussians": len(result.model),
        **_sizes(result),
        "peak_rss_mb": _peak_memory_mb(folder),
    }


def _evaluate(cfg: Config, data: Prepared, folder: RunFolder, log: Log) -> dict:
    """checkpoint.safetensors → metrics.json, per_image.csv, renders/."""
    scene, cfg = data.scene, _as_decided(cfg, data, folder)
    trained = folder.values_of("train")
    saved = checkpoints.load(folder.checkpoint)
    final = evaluate_with_images(saved.model, scene, cfg, thread_count(cfg.threads), folder.renders)
    best, best_metrics = None, None
    if cfg.evaluate.best_on_test and saved.best is not None and saved.best_model is not None:
        is_final = saved.best["iteration"] == saved.iteration
        best = final if is_final else evaluate(saved.best_model, scene, cfg, thread_count(cfg.threads))
        best_metrics = {**best.metrics, "iteration": saved.best["iteration"]}

    selection, decided = _selection(folder), _motion(folder)
    write_csv(folder.per_image, _per_image(final, best))
    write_json(folder.metrics, {
        "scene": cfg.scene.name, "ablation": cfg.ablation.name, "train": cfg.train.name, "seed": cfg.seed,
        "date": now(),
        "final": final.metrics,
        "best_on_test": best_metrics,
        **({} if scene.test_split is None else {"test_split": scene.test_split}),
        "model": asdict(saved.model.kind),  # as trained: selection may have left out what `ablation` has
        **({} if decided is None else {MOTION: {**asdict(decided), "dynamic": decided.dynamic}}),
        SELECTION: None if selection is None else {**asdict(selection), "kept": selection.kept},
        **({"outlook": _outlook(final, saved.model, data)} if data.is_clip else {}),
        "note": final.note(), "n_alive_mean": final.n_alive_mean, "n_test_views": len(scene.test), **trained,
    })  # fmt: skip
    return {"psnr": final.metrics["psnr"]}


def _view(cfg: Config, data: Prepared, folder: RunFolder, log: Log) -> dict:
    """checkpoint.safetensors → viewer.html."""
    model = checkpoints.load_model(folder.checkpoint)
    write_viewer(
        folder.viewer, [Shown(cfg.ablation.name, model, folder.values_of("evaluate")["psnr"])], data.scene, cfg
    )
    return {}


@contextmanager
def _live_view(cfg: Config, scene: Scene, log: Log) -> Iterator[TrainingView | None]:
    """Serves the run's page while it is trained, if `cfg.view` asks for it."""
    if not cfg.view:
        yield None
        return
    feed = Feed()
    with LiveServer(address_of(cfg.view_at, "view_at"), live_page(cfg.ablation.name, scene, cfg), feed) as server:
        log(f"live view: {server.url}")
        yield TrainingView(feed, scene, cfg.train.iterations)


def _outlook(final: Evaluation, model: Model, data: Prepared) -> str:
    psnr = final.metrics["psnr"]
    assert isinstance(psnr, float)
    seconds = (data.scene.duration / data.canonical.time_scale) if model.kind.dims == 4 else None
    return outlook(path_angles(data.scene, seconds), psnr, dynamic=model.kind.dims == 4)


def _selection(folder: RunFolder) -> select_time_colour.Selection | None:
    """The run's selection of time-varying colour; None where it had none."""
    found = folder.values_of(SELECTION) if folder.inputs_of(SELECTION) else None
    return select_time_colour.Selection(**found) if found else None


def _motion(folder: RunFolder) -> motion.MotionSelection | None:
    """The run's decision between static and dynamic; None where there was none to take."""
    return motion.MotionSelection(**folder.values_of(MOTION)) if folder.inputs_of(MOTION) else None


def _as_decided(cfg: Config, data: Prepared, folder: RunFolder) -> Config:
    """The configuration of the model that select_motion decided for."""
    decided = _motion(folder)
    return cfg if decided is None or decided.dynamic else motion.without_time(cfg, data.scene)


_RUN = {
    "sfm": _sfm,
    MOTION: _select_motion,
    SELECTION: _select_time_colour,
    "init": _init,
    "train": _train,
    "evaluate": _evaluate,
    "view": _view,
}

# The files each stage writes; a stage whose output was deleted is not done.
_OUTPUTS: dict[str, tuple[Callable[[RunFolder], Path], ...]] = {
    "sfm": (lambda folder: folder.sfm, lambda folder: folder.sfm_picture),
    MOTION: (),  # its result is in stages.json
    SELECTION: (),  # its result is in stages.json
    "init": (lambda folder: folder.init_ply,),
    "train": (lambda folder: folder.checkpoint, lambda folder: folder.curve),
    "evaluate": (lambda folder: folder.metrics, lambda folder: folder.per_image, lambda folder: folder.renders),
    "view": (lambda folder: folder.viewer,),
}


def _done(folder: RunFolder, stage: str, inputs: str) -> bool:
    return folder.inputs_of(stage) == inputs and all(output(folder).exists() for output in _OUTPUTS[stage])


def _sizes(result: TrainResult) -> dict[str, float]:
    """In MB of 10⁶ bytes: the parameters alone, and with Adam's moments."""
    return {
        "model_mb": result.model.bytes / 1e6,
        "model_with_optimiser_mb": (result.model.bytes + result.optimiser_bytes) / 1e6,
    }


def _peak_memory_mb(folder: RunFolder) -> float:
    """The highest of this process and of the interrupted ones it continues, which log.jsonl holds."""
    return max([peak_memory_mb(), *(row["peak_rss_mb"] for row in folder.log_rows() if "peak_rss_mb" in row)])


def _per_image(final: Evaluation, best: Evaluation | None) -> list[dict]:
    rows = [{"model": "final", **row} for row in final.per_image]
    return rows + [{"model": "best_on_test", **row} for row in (best.per_image if best else [])]


def _digest(*arrays: np.ndarray) -> str:
    digest = hashlib.blake2b(digest_size=16)
    for array in arrays:
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def _hash(*parts: object) -> str:
    return hashlib.blake2b(json.dumps(parts, sort_keys=True, default=str).encode(), digest_size=16).hexdigest()
