"""Stage init: the Gaussians that training begins with."""

from __future__ import annotations

from datasets.files.atomic_write import atomic_file, write_json
from pipeline.config.random_streams import Stream, stream
from pipeline.config.schema import Config
from pipeline.data.prepared import Prepared
from pipeline.model.initialise import initialise
from pipeline.model.ply import save_ply
from pipeline.runs.run_folder import RunFolder
from pipeline.stages.decisions import as_decided, time_colour_of
from pipeline.stages.stage import Log
from pipeline.training.selection import time_colour


def make_initial_model(cfg: Config, data: Prepared, folder: RunFolder, log: Log) -> dict:
    """scene and points → init.ply; and in canonical.json how its coordinates come from the files'."""
    cfg = as_decided(cfg, data, folder)
    if (selection := time_colour_of(folder)) and not selection.kept:
        cfg = time_colour.without_time_colour(cfg)
    model = initialise(data.scene, cfg, stream(cfg.seed, Stream.INIT), data.cloud)
    with atomic_file(folder.init_ply) as temporary:
        save_ply(temporary, model)
    if not data.canonical.is_identity:
        write_json(folder.canonical, data.canonical.to_dict())
    return {"n_gaussians": len(model)}
