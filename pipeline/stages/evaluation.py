"""Stage evaluate: numbers and pictures of the held-out views."""

from __future__ import annotations

from dataclasses import asdict

from datasets.files.atomic_write import write_json
from pipeline.config.schema import Config
from pipeline.data.prepared import Prepared
from pipeline.evaluation.evaluate import Evaluation, evaluate, evaluate_with_images
from pipeline.evaluation.outlook import outlook, path_angles
from pipeline.model.model import Model
from pipeline.model.velocities import in_rotations
from pipeline.runs.run_folder import RunFolder, now, write_csv
from pipeline.stages.decisions import MOTION, TIME_COLOUR, as_decided, motion_of, time_colour_of
from pipeline.stages.stage import Log
from pipeline.training import checkpoint as checkpoints
from rasterizer.cores import thread_count


def evaluate_model(cfg: Config, data: Prepared, folder: RunFolder, log: Log) -> dict:
    """checkpoint.safetensors → metrics.json, per_image.csv, renders/."""
    scene, cfg = data.scene, as_decided(cfg, data, folder)
    trained = folder.values_of("train")
    saved = checkpoints.load(folder.checkpoint)
    model = in_rotations(saved.model)
    final = evaluate_with_images(model, scene, cfg, thread_count(cfg.threads), folder.renders)
    best, best_metrics = None, None
    if cfg.evaluate.best_on_test and saved.best is not None and saved.best_model is not None:
        is_final = saved.best["iteration"] == saved.iteration
        best = final if is_final else evaluate(in_rotations(saved.best_model), scene, cfg, thread_count(cfg.threads))
        best_metrics = {**best.metrics, "iteration": saved.best["iteration"]}

    selection, decided = time_colour_of(folder), motion_of(folder)
    write_csv(folder.per_image, _per_image(final, best))
    write_json(folder.metrics, {
        "scene": cfg.scene.name, "ablation": cfg.ablation.name, "train": cfg.train.name, "seed": cfg.seed,
        "date": now(),
        "final": final.metrics,
        "best_on_test": best_metrics,
        **({} if scene.test_split is None else {"test_split": scene.test_split}),
        "model": asdict(model.kind),  # as trained: selection may have left out what `ablation` has
        **({} if decided is None else {MOTION: {**asdict(decided), "dynamic": decided.dynamic}}),
        TIME_COLOUR: None if selection is None else {**asdict(selection), "kept": selection.kept},
        **({"outlook": _outlook(final, model, data)} if data.poses_estimated and scene.capture == "clip" else {}),
        "note": final.note(), "n_alive_mean": final.n_alive_mean, "n_test_views": len(scene.test), **trained,
    })  # fmt: skip
    return {"psnr": final.metrics["psnr"]}


def _outlook(final: Evaluation, model: Model, data: Prepared) -> str:
    psnr = final.metrics["psnr"]
    assert isinstance(psnr, float)
    seconds = (data.scene.duration / data.canonical.time_scale) if model.kind.dims == 4 else None
    return outlook(path_angles(data.scene, seconds), psnr, dynamic=model.kind.dims == 4)


def _per_image(final: Evaluation, best: Evaluation | None) -> list[dict]:
    rows = [{"model": "final", **row} for row in final.per_image]
    return rows + [{"model": "best_on_test", **row} for row in (best.per_image if best else [])]
