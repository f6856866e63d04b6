"""Command line of the viewer: `python -m pipeline.view RUN [RUN …] [--out FILE]`; `RUN --live` while it is trained."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import NoReturn

from datasets.files.errors import read_json
from pipeline.terminal.closed_pipe import quiet_on_closed_pipe
from pipeline.terminal.command_line import log
from pipeline.trained.open_run import TrainedRun, open_run
from pipeline.view.cameras import cameras_of
from pipeline.view.live.address import DEFAULT_ADDRESS, address_of
from pipeline.view.live.followed_run import serve_run
from pipeline.view.viewer import FILE_NAME, Shown, write_viewer

_DESCRIPTION = """\
Writes one HTML file that plays the runs in a browser, from disk and without a network. Several runs
of one scene are shown side by side, in step."""


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        self.exit(2, f"error: {message}\n")


@quiet_on_closed_pipe()
def main(arguments: list[str] | None = None) -> int:
    """Runs the command and returns its exit status: 1, after one line, for what is no run and for a full disk."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.live and len(options.runs) > 1:
        parser.error(f"--live: expected one run, found {len(options.runs)}")
    try:
        if options.live:
            serve_run(options.runs[0], address_of(options.at, "--at"), log)
            return 0
        out = options.out or (options.runs[0] / FILE_NAME if len(options.runs) == 1 else Path(FILE_NAME))
        runs = [open_run(folder, log) for folder in options.runs]
        _refuse_other_views(options.runs, runs)
        shown = [
            Shown(label, run.model, _psnr(folder))
            for label, run, folder in zip(_labels(options.runs, runs), runs, options.runs)
        ]
        write_viewer(out, shown, runs[0].scene, runs[0].cfg)
        log(f"{out}: {out.stat().st_size / 1e6:.1f} MB; open it in a browser")
    except BrokenPipeError:
        raise
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="python -m pipeline.view", description=_DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("runs", type=Path, nargs="+", metavar="RUN", help="folder of a trained run")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help=f"default: RUN/{FILE_NAME}; of several runs {FILE_NAME}"
    )
    parser.add_argument(
        "--live", action="store_true", help="serve the page, and the run's newest checkpoint, until Ctrl-C"
    )
    parser.add_argument(
        "--at",
        default=DEFAULT_ADDRESS,
        metavar="HOST:PORT",
        help="with --live: where (default: %(default)s, which no other machine reaches)",
    )
    return parser


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
    path = folder / "metrics.json"
    found = read_json(path) if path.exists() else {}
    final = found.get("final") if isinstance(found, dict) else None
    psnr = final.get("psnr") if isinstance(final, dict) else None
    return float(psnr) if isinstance(psnr, (int, float)) else None


if __name__ == "__main__":
    sys.exit(main())
