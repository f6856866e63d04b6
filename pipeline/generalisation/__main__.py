"""What overfits, seen: python -m pipeline.generalisation RUN [RUN …]

For runs of one scene: PSNR of training and of held-out views, and the Gaussians' lifetimes, as training goes on
(generalisation.svg), and the middle test view's moment from the training view nearest in time and from the test view
itself, truth beside each run's render (moment.webp).
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from pipeline.evaluate import Renderer
from pipeline.trained_run import open_run
from pipeline.views import target_of
from rasterizer import Frame

from .draw import draw, mosaic
from .history import read_history


def moment(folders: list[Path]) -> list[list[np.ndarray]]:
    """Two rows, the seen and the unseen view: the truth, then each run's render."""
    rows: list[list[np.ndarray]] = [[], []]
    for folder in folders:
        run = open_run(folder, print)
        unseen = run.scene.test[len(run.scene.test) // 2]
        seen = min(run.scene.train, key=lambda view: abs(view.time - unseen.time))
        renderer = Renderer(run.model, run.scene, run.cfg, Frame())
        for row, view in zip(rows, (seen, unseen)):
            target = target_of(view, run.cfg.train.resolution_scale)
            if not row:
                row.append(target.image.numpy().transpose(1, 2, 0))
            row.append(renderer.image(target.camera, view.time))
    return rows


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m pipeline.generalisation", description=__doc__.splitlines()[0])
    parser.add_argument("runs", type=Path, nargs="+", metavar="RUN", help="folders of finished runs of one scene")
    parser.add_argument("--out", type=Path, default=Path("results/generalisation"), help="(results/generalisation)")
    options = parser.parse_args(arguments)
    try:
        histories = [read_history(folder) for folder in options.runs]
        for folder, history in zip(options.runs, histories):
            if history.scene != histories[0].scene:
                raise ValueError(f"{folder}: expected a run of {histories[0].scene}, found one of {history.scene}")
        pictures = moment(options.runs)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 1
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "generalisation.svg").write_text(draw(histories), encoding="utf-8")
    mosaic(pictures).save(options.out / "moment.webp", quality=90)
    print(f"{'run':30} {'train dB':>9} {'held out':>9} {'median lifetime, frames':>24}")
    for h in histories:
        life = "–" if h.lifetimes is None else f"{h.lifetimes[-1, 2]:.1f}"
        print(f"{h.label:30} {h.train_psnr[-1]:9.2f} {h.psnr[-1]:9.2f} {life:>24}")
    print(f"written to {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
