"""The page that plays runs in a browser.

Writes one HTML file that plays the runs from disk and without a network. Several runs of one scene are shown side by
side, in step. With --live the page of one run that is being trained is served instead.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from datasets.files.errors import read_json
from pipeline.terminal.command_line import CommandParser, command, log
from pipeline.trained.open_run import TrainedRun, open_run
from pipeline.view.cameras import cameras_of
from pipeline.view.live.followed_run import serve_run
from pipeline.view.live.server import DEFAULT_ADDRESS, address_of
from pipeline.view.viewer import FILE_NAME, Shown, write_viewer


@command
def main(arguments: list[str]) -> int:
    parser = CommandParser("view", __doc__)
    add = parser.add_argument
    add("runs", type=Path, nargs="+", metavar="RUN", help="folder of a trained run")
    add("--out", type=Path, metavar="FILE", help=f"default: RUN/{FILE_NAME}; of several runs {FILE_NAME}")
    add("--data", type=Path, metavar="DIR", help="where the data set is now (default: where it was)")
    add("--live", action="store_true", help="serve the page, and the run's newest checkpoint, until Ctrl-C")
    where = "with --live: where (default: %(default)s, which no other machine reaches)"
    add("--at", default=DEFAULT_ADDRESS, metavar="HOST:PORT", help=where)
    options = parser.parse_args(arguments)
    if options.live:
        parser.require(len(options.runs) == 1, "--live", "one run", len(options.runs))
        for name in ("out", "data"):
            parser.require(getattr(options, name) is None, f"--{name}", "no --live beside it", getattr(options, name))
        serve_run(options.runs[0], address_of(options.at, "--at"), log)
        return 0
    out = options.out or (options.runs[0] / FILE_NAME if len(options.runs) == 1 else Path(FILE_NAME))
    runs = [open_run(folder, log, options.data) for folder in options.runs]
    if options.out is None and out.exists() and not runs[0].has_images:
        log(f"{out}: kept, as it may have the images; --out writes another page")
        return 0
    _refuse_other_views(options.runs, runs)
    labels = _labels(options.runs, runs)
    shown = [Shown(label, run.model, _psnr(path)) for label, run, path in zip(labels, runs, options.runs)]
    write_viewer(out, shown, runs[0].scene, runs[0].cfg, with_truths=runs[0].has_images)
    log(f"{out}: {out.stat().st_size / 1e6:.1f} MB; open it in a browser")
    return 0


def _refuse_other_views(folders: list[Path], runs: list[TrainedRun]) -> None:
    """ValueError where the runs have not the same cameras, times and background: a page has one of each."""

    def views(run: TrainedRun) -> str:
        cameras = cameras_of(run.scene, run.cfg.train.resolution_scale, with_truths=False)
        return json.dumps([run.cfg.scene.name, cameras.header, list(run.scene.background), run.cfg.scene.near])

    for folder, run in zip(folders[1:], runs[1:]):
        if views(run) != views(runs[0]):
            raise ValueError(
                f"{folder}: expected a run of {runs[0].cfg.scene.name} with the cameras, times, background and near "
                f"plane of {folders[0]}, found {run.cfg.scene.name} with others; runs side by side are of one scene at "
                "one size"
            )


def _labels(folders: list[Path], runs: list[TrainedRun]) -> list[str]:
    """In what the runs differ: ablation, schedule, seed; else the folder."""
    parts = [(run.cfg.ablation.name, run.cfg.train.name, f"seed {run.cfg.seed}") for run in runs]
    differing = [column for column in range(3) if len({row[column] for row in parts}) > 1] or [0]
    labels = [" · ".join(row[column] for column in differing) for row in parts]
    return labels if len(set(labels)) == len(labels) else [str(folder) for folder in folders]


def _psnr(folder: Path) -> float | None:
    """Of the run's metrics.json; None where there is none."""
    try:
        return float(read_json(folder / "metrics.json")["final"]["psnr"])
    except (OSError, KeyError, TypeError):
        return None


if __name__ == "__main__":
    sys.exit(main())
