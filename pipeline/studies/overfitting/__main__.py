"""Overfitting of trained runs of one scene: training against held-out views.

Writes overfitting.svg (PSNR of training and held-out views and lifetimes over the schedule, effective view counts) and
moment.webp (the middle test view, and above it the training view nearest in time: ground truth, then each run's
render). Prints the final numbers and, where moving pixels are known, the error in these and in the others.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from pipeline.data.training_views import target_of
from pipeline.evaluation.renderer import Renderer
from pipeline.studies.command_line import StudyParser, log, study_command
from pipeline.studies.output import write_results
from pipeline.studies.overfitting.effective_view_count import effective_view_count
from pipeline.studies.overfitting.error_by_motion import error_by_motion
from pipeline.studies.overfitting.history import History, read_history
from pipeline.studies.overfitting.plot import draw, image_grid
from pipeline.studies.overfitting.table import motion_summary, summary
from pipeline.trained.open_run import TrainedRun, open_run
from rasterizer import Rasterizer
from rasterizer.cores import thread_count

NAME = "overfitting"


@study_command
def main(arguments: list[str]) -> int:
    parser = StudyParser(NAME, __doc__)
    parser.add_argument("runs", type=Path, nargs="+", metavar="RUN", help="folders of finished runs of one scene")
    options = parser.parse_args(arguments)
    histories = read_histories(options.runs)
    runs = [open_run(folder, log) for folder in options.runs]
    view_counts = [
        effective_view_count(run.model, run.scene, run.cfg, thread_count(run.cfg.threads)).numpy() for run in runs
    ]
    images = image_grid(train_and_test_view(runs))
    written = write_results(
        options.out,
        {f"{NAME}.svg": draw(histories, view_counts), "moment.webp": lambda path: images.save(path, quality=90)},
    )
    print(summary(histories, view_counts))
    errors = [error for run in runs if (error := error_by_motion(run)) is not None]
    if len(errors) == len(runs):
        print(f"\n{motion_summary(histories, errors)}")
    print(written)
    return 0


def read_histories(folders: list[Path]) -> list[History]:
    """ValueError, one line, where a folder is no finished run or the scenes differ."""
    histories = [read_history(folder) for folder in folders]
    for folder, history in zip(folders, histories):
        if history.scene != histories[0].scene:
            raise ValueError(f"{folder}: expected a run of {histories[0].scene}, found one of {history.scene}")
    return histories


def train_and_test_view(runs: list[TrainedRun]) -> list[list[np.ndarray]]:
    """Two rows of images, the training view and the test view: the ground truth, then each run's render."""
    rows: list[list[np.ndarray]] = [[], []]
    for run in runs:
        held_out = run.scene.test[len(run.scene.test) // 2]
        nearest = min(run.scene.train, key=lambda view: abs(view.time - held_out.time))
        renderer = Renderer(run.model, run.scene, run.cfg, Rasterizer())
        for row, view in zip(rows, (nearest, held_out)):
            target = target_of(view, run.cfg.train.resolution_scale)
            if not row:
                row.append(target.image.numpy().transpose(1, 2, 0))
            row.append(renderer.image(target.camera, view.time))
    return rows


if __name__ == "__main__":
    sys.exit(main())
