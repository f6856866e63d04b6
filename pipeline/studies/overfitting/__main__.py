"""What overfits, seen: python -m pipeline.studies.overfitting RUN [RUN …]

For runs of one scene: PSNR of training and of held-out views and the Gaussians' lifetimes as training goes on, and by
how many training views they are seen (generalisation.svg); the middle test view's moment from the training view nearest
in time and from the test view itself, truth beside each run's render (moment.webp). Where the held-out camera stands
still, how much of the error is on what moves.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from pipeline.data.training_views import target_of
from pipeline.evaluation.evaluate import Renderer
from pipeline.studies.open_run import TrainedRun, open_run
from pipeline.studies.overfitting.error_by_motion import error_by_motion
from pipeline.studies.overfitting.history import read_history
from pipeline.studies.overfitting.plot import draw, mosaic
from pipeline.studies.overfitting.view_count import effective_view_count
from pipeline.terminal.closed_pipe import quiet_on_closed_pipe
from rasterizer import Rasterizer
from rasterizer.cores import thread_count

ONE_VIEW = 1.5  # seen by fewer, effectively, is seen by one


def moment(runs: list[TrainedRun]) -> list[list[np.ndarray]]:
    """Two rows, the seen and the unseen view: the truth, then each run's render."""
    rows: list[list[np.ndarray]] = [[], []]
    for run in runs:
        unseen = run.scene.test[len(run.scene.test) // 2]
        seen = min(run.scene.train, key=lambda view: abs(view.time - unseen.time))
        renderer = Renderer(run.model, run.scene, run.cfg, Rasterizer())
        for row, view in zip(rows, (seen, unseen)):
            target = target_of(view, run.cfg.train.resolution_scale)
            if not row:
                row.append(target.image.numpy().transpose(1, 2, 0))
            row.append(renderer.image(target.camera, view.time))
    return rows


@quiet_on_closed_pipe()
def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m pipeline.studies.overfitting", description=__doc__.splitlines()[0])
    parser.add_argument("runs", type=Path, nargs="+", metavar="RUN", help="folders of finished runs of one scene")
    parser.add_argument("--out", type=Path, default=Path("results/generalisation"), help="(results/generalisation)")
    options = parser.parse_args(arguments)
    try:
        histories = [read_history(folder) for folder in options.runs]
        for folder, history in zip(options.runs, histories):
            if history.scene != histories[0].scene:
                raise ValueError(f"{folder}: expected a run of {histories[0].scene}, found one of {history.scene}")
        runs = [open_run(folder, print) for folder in options.runs]
    except ValueError as error:
        print(error, file=sys.stderr)
        return 1
    views = [effective_view_count(run.model, run.scene, run.cfg, thread_count(run.cfg.threads)).numpy() for run in runs]
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "generalisation.svg").write_text(draw(histories, views), encoding="utf-8")
    mosaic(moment(runs)).save(options.out / "moment.webp", quality=90)
    print(
        f"{'run':30} {'train dB':>9} {'held out':>9} {'Gaussians':>10} {'seen by one view':>17} "
        f"{'median lifetime, frames':>24}"
    )
    for h, found in zip(histories, views):
        life = "–" if h.lifetimes is None else f"{h.lifetimes[-1, 2]:.1f}"
        print(
            f"{h.label:30} {h.train_psnr[-1]:9.2f} {h.psnr[-1]:9.2f} {len(found):10,} "
            f"{np.mean(found < ONE_VIEW):17.0%} {life:>24}"
        )
    errors = [error_by_motion(run) for run in runs]
    if None not in errors:
        print(f"\n{'run':30} {'pixels that move':>17} {'error on them':>14} {'dB there':>9} {'dB elsewhere':>13}")
        for h, e in zip(histories, errors):
            print(f"{h.label:30} {e.moving:17.1%} {e.error:14.0%} {e.moving_psnr:9.2f} {e.still_psnr:13.2f}")
    print(f"written to {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
