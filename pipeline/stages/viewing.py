"""Stage view: the page that plays the trained model."""

from __future__ import annotations

from pipeline.config.schema import Config
from pipeline.data.prepared import Prepared
from pipeline.runs.run_folder import RunFolder
from pipeline.stages.stage import Log
from pipeline.training import checkpoint as checkpoints
from pipeline.view.viewer import Shown, write_viewer


def write_page(cfg: Config, data: Prepared, folder: RunFolder, log: Log) -> dict:
    """checkpoint.safetensors → viewer.html."""
    model = checkpoints.load_model(folder.checkpoint)
    write_viewer(
        folder.viewer, [Shown(cfg.ablation.name, model, folder.values_of("evaluate")["psnr"])], data.scene, cfg
    )
    return {}
