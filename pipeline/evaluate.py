"""Evaluates a model on the test views of a scene, wherever it was trained.

MODEL is a run folder or a file: a checkpoint of this program (.safetensors), one of the released program (.pth), or a
.ply file. The scene and all other keys are those of `python -m pipeline`: scene=dnerf/lego scene.path=DIR. Writes
metrics.json, per_image.csv and renders/. A .pth file has the coordinates of the data's files, a .safetensors file
canonical ones: those of the run, if its canonical.json is beside it. A .ply file has those that its comment states, or
its run's; of others it is found out and said.
"""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table

from datasets.canonical import Canonical
from datasets.files.atomic_write import write_json
from pipeline.config.compose import command_of
from pipeline.config.schema import Config
from pipeline.data.prepare import Prepared, prepare
from pipeline.evaluation.evaluate import Evaluation, evaluate_with_images
from pipeline.model.model import Model
from pipeline.model.ply import positions_of, stated_coordinates
from pipeline.model.transformed import in_canonical
from pipeline.runs.run_folder import now, write_csv
from pipeline.runs.run_identity import read_config
from pipeline.stages.settle import for_scene
from pipeline.terminal.command_line import CommandParser, command, log
from pipeline.trained.coordinates import NAMES, placed
from pipeline.trained.open_run import read_model, stored_canonical
from pipeline.training.checkpoint import FILE_NAME
from rasterizer.cores import thread_count


@command
def main(arguments: list[str]) -> int:
    parser = CommandParser("evaluate", __doc__)
    parser.add_argument("model", type=Path, metavar="MODEL", help="a run folder or a file of a model")
    parser.add_argument("keys", nargs="+", metavar="KEY=VALUE", help="scene=…, and any other key")
    parser.add_argument("--out", type=Path, metavar="DIR", help="default: results/evaluated/SCENE/MODEL")
    parser.add_argument("--coordinates", choices=NAMES, help="of a .ply that does not state them (default: found out)")
    options = parser.parse_intermixed_args(arguments)
    order, cfg = command_of(options.keys)
    path = options.model / FILE_NAME if options.model.is_dir() else options.model
    if not path.is_file():  # before what structure from motion may take
        raise ValueError(f"{path}: expected a run folder or a file of a model, found none")
    torch.set_num_threads(1)  # as in a run: views are measured side by side
    data = prepare(cfg, log)
    cfg = for_scene(order, data)
    model = _in_scene(read_model(path, data.canonical), path, cfg, data, options.coordinates)
    out = options.out or Path("results") / "evaluated" / cfg.scene.name / name_of(options.model)
    log(f"evaluate: {len(model)} Gaussians of {path} on {len(data.scene.test)} test views of {cfg.scene.name}")
    (out / "renders").mkdir(parents=True, exist_ok=True)
    found = evaluate_with_images(model, data.scene, cfg, thread_count(cfg.threads), out / "renders")
    write_csv(out / "per_image.csv", found.per_image)
    write_json(out / "metrics.json", _metrics(cfg, path, model, found))
    Console(highlight=False, soft_wrap=True).print(_table(found))
    log(f"written to {out}")
    return 0


def name_of(model: Path) -> str:
    """Of the folder of its results: `full_fast_seed0` of the run folder …/full/fast/seed0, and with the file's name."""
    path = model.resolve()
    folder, file = (path, ()) if model.is_dir() else (path.parent, (path.stem,))
    return "_".join((*folder.parts[1:][-3:], *file))


def _in_scene(model: Model, path: Path, cfg: Config, data: Prepared, told: str | None) -> Model:
    """The model, which `read_model` read, in the canonical coordinates of the scene as it is read now.

    They depend on the training cameras in use and, of videos, on the first frame; a file or its run's folder says what
    its own are. told: the user's word for a .ply that does not.
    """
    if path.suffix == ".pth":
        return model
    own = stated_coordinates(path) if path.suffix == ".ply" else None
    own = own or _of_its_run(path, cfg, data)
    if own is None and path.suffix == ".ply":
        if told is None:
            return placed(model, positions_of(path), path, cfg, data, thread_count(cfg.threads), log)
        own = Canonical() if told == "data" else None
    if own is None or own == data.canonical:
        return model
    log(f"evaluate: from the coordinates of {path.name} ({own}) to those of the scene's training cameras now")
    return in_canonical(model, own.inverse.then(data.canonical))


def _of_its_run(path: Path, cfg: Config, data: Prepared) -> Canonical | None:
    """From the data's coordinates to those of a file in a run's folder; None: in another folder."""
    stored, config = path.with_name("canonical.json"), path.with_name("config.yaml")
    if not stored.is_file():
        return Canonical() if config.is_file() else None
    first = read_config(config).get("scene", {}).get("first_frame", 0) if config.is_file() else cfg.scene.first_frame
    if data.scene.frame_rate is not None and first != cfg.scene.first_frame:
        raise ValueError(
            f"scene.first_frame: expected {first}, from which the times of {path.parent} count, "
            f"found {cfg.scene.first_frame}"
        )
    return stored_canonical(path.parent)


def _metrics(cfg: Config, path: Path, model: Model, found: Evaluation) -> dict:
    return {
        "scene": cfg.scene.name,
        "model_file": str(path),
        "kind": asdict(model.kind),
        "date": now(),
        "final": found.metrics,
        "n_gaussians": len(model),
        "model_mb": model.bytes / 1e6,
        "n_alive_mean": found.n_alive_mean,
        "n_test_views": len(found.per_image),
        "note": found.note(),
    }


def _table(found: Evaluation) -> Table:
    """The numbers that there are, by their names in metrics.json."""
    table = Table("", "mean over the test views")
    for name, value in found.metrics.items():
        if isinstance(value, float):
            table.add_row(name, f"{value:.4g}")
    return table


if __name__ == "__main__":
    sys.exit(main())
