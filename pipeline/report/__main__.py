"""Command line of the report: `python -m pipeline.report RUNS_DIR… [--out DIR]`."""

from __future__ import annotations

import sys
from pathlib import Path

from pipeline.report.build import build_report
from pipeline.report.output_folder import replace_report
from pipeline.report.site import build_site
from pipeline.terminal.command_line import CommandParser, command

_DESCRIPTION = """\
Compares finished runs and writes into DIR:

  report.html   one self-contained page with tables, plots and images
  report.md     the same as Markdown
  tables/       each table as .md and .csv (full precision)
  plots/        learning curves (.svg)
  strips/       render, truth and difference of held-out views (.webp)

A new report replaces the files of the previous one in DIR and no others."""
_EXIT_STATUS = "Exit status: 0, also if some runs can't be read (they are named on stderr); 1 if no run can be read."


@command
def main(arguments: list[str]) -> int:
    """Runs the command and returns its exit status. All files are written before anything is printed."""
    parser = _parser()
    options = parser.parse_args(arguments)
    out = options.out or options.runs_dirs[0].resolve().parent / "report"
    if options.site:
        for name in ("out", "latex", "nerfbaselines"):
            parser.require(not getattr(options, name), f"--{name}", "no --site beside it", options.site)
        site = build_site(options.runs_dirs, tuple(options.no_pictures), tuple(options.psnr))
        replace_report(options.site, site.files)
        for line in site.warnings:
            print(f"warning: {line}", file=sys.stderr)
        print(f"Site: {options.site / 'index.html'}, {len(site.files)} files", flush=True)
        return 0
    report = build_report(
        options.runs_dirs, tuple(options.no_pictures), tuple(options.psnr), options.latex, out, options.nerfbaselines
    )
    replace_report(out, report.files)
    for line in report.warnings:
        print(f"warning: {line}", file=sys.stderr)
    print(report.terminal)
    print(f"Page: {out / 'report.html'}   tables: {out / 'tables'}   plots: {out / 'plots'}", flush=True)
    return 0


def _parser() -> CommandParser:
    parser = CommandParser("report", _DESCRIPTION, _EXIT_STATUS)
    parser.add_argument(
        "runs_dirs",
        type=Path,
        nargs="+",
        metavar="RUNS_DIR",
        help="folder with run folders, at any depth; of several, as of several machines, all runs are compared",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="output folder (default: RUNS_DIR/../report)")
    parser.add_argument("--site", type=Path, metavar="DIR", help="write a site instead: leaderboards, a page a scene")
    shape = "write each run as a result file of NerfBaselines too, in DIR/nerfbaselines"
    parser.add_argument("--nerfbaselines", action="store_true", help=shape)
    parser.add_argument("--latex", action="store_true", help="write each table as .tex too (needs booktabs)")
    parser.add_argument(
        "--no-pictures",
        nargs="*",
        default=[],
        metavar="SCENE",
        help="scenes (dnerf/lego) or families (dnerf) whose images must not be published",
    )
    parser.add_argument(
        "--psnr",
        nargs="*",
        type=float,
        default=[],
        metavar="DB",
        help="PSNR levels of the table of training time to a PSNR (default: chosen per scene)",
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
