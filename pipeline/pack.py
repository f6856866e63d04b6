"""Packs a run, so that others can check its numbers: what it rendered of each test view to the bit, the SHA-256 of the
true images and of the checkpoint, metrics and configuration. `python -m pipeline.score PACK.zip scene=…` measures it.
"""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path

import torch

from datasets.files.atomic_write import atomic_file
from datasets.files.errors import read_json
from pipeline.evaluation.evaluate import measure_images, rendered_by
from pipeline.evaluation.packed_images import PackWriter, differing
from pipeline.evaluation.renderer import Renderer
from pipeline.runs.run_identity import FILES
from pipeline.terminal.command_line import CommandParser, command, log
from pipeline.trained.open_run import open_run
from rasterizer import engine_for
from rasterizer.cores import thread_count


@command
def main(arguments: list[str]) -> int:
    parser = CommandParser("pack", __doc__)
    parser.add_argument("run", type=Path, metavar="RUN", help="folder of a finished run")
    parser.add_argument("--data", type=Path, metavar="DIR", help="where the data set is now (default: where it was)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="default: RUN/exports/images.zip")
    options = parser.parse_args(arguments)
    run, out = options.run, options.out or options.run / FILES["exports"] / "images.zip"
    if not (run / FILES["metrics"]).is_file():
        raise ValueError(f"{run}: expected a finished run with metrics.json, found none")
    packed = read_json(run / FILES["metrics"])["final"]
    trained = open_run(run, log, options.data)
    torch.set_num_threads(1)
    scene, cfg, threads = trained.scene, trained.cfg, thread_count(trained.cfg.threads)
    model = rendered_by(Renderer(trained.model, scene, cfg, engine_for(cfg.backend, threads)))
    out.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(out) as temporary:
        with zipfile.ZipFile(temporary, "w") as file:
            writer = PackWriter(file, scene, model)
            found = measure_images(scene, cfg, threads, writer.render)
            writer.finish(run, run / FILES["checkpoint"])
        if wrong := differing(packed, found.metrics):
            raise ValueError(f"{run}: its model has not the numbers of its metrics.json: {'; '.join(wrong[:3])}")
    log(f"{out}: {len(scene.test)} test views, {out.stat().st_size / 1e6:.1f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
