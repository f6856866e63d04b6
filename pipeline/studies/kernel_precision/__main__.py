"""The kernel's work–precision diagram: python -m pipeline.studies.kernel_precision

Builds the kernel with other numerical choices, measures each one's errors against the float64 twin and its CPU time,
and writes a table and a plot in which the Pareto front and the defaults are marked.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import torch

from pipeline.runs.provenance import provenance
from pipeline.studies.kernel_precision.build import BuildError, load_variants
from pipeline.studies.kernel_precision.measure import measure
from pipeline.studies.kernel_precision.plot import draw
from pipeline.studies.kernel_precision.table import comma_separated, markdown, verdicts
from pipeline.studies.kernel_precision.trained import workload_of
from pipeline.studies.kernel_precision.variants import DEFAULT, all_variants
from pipeline.terminal.closed_pipe import quiet_on_closed_pipe
from rasterizer.kernel import kernel
from rasterizer.memory import keep_freed_memory
from rasterizer.timing.workloads import WORKLOADS, make_workload


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m pipeline.studies.kernel_precision", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--workload", choices=WORKLOADS, default="W1", help="times are of all of it (W1)")
    parser.add_argument("--run", type=Path, metavar="FOLDER", help="instead: a trained run, its middle test view")
    parser.add_argument("--pixels", type=int, default=64, help="errors are of its middle, so many pixels square (64)")
    parser.add_argument("--rounds", type=int, default=20, help="how often all kernels are timed in turn (20)")
    parser.add_argument("--only", nargs="+", metavar="VARIANT", help="these and the default (default: all)")
    parser.add_argument("--out", type=Path, default=Path("results/work_precision"), help="(results/work_precision)")
    options = parser.parse_args(arguments)
    known = {variant.name for variant in all_variants()}
    for name in options.only or []:
        if name not in known:
            parser.error(f"--only: expected some of {', '.join(sorted(known))}, found {name!r}")
    if options.pixels < 1 or options.rounds < 1:
        parser.error(f"--pixels and --rounds: expected at least 1, found {options.pixels} and {options.rounds}")
    return options


@quiet_on_closed_pipe()
def main(arguments: list[str] | None = None) -> int:
    options = parse(arguments)
    keep_freed_memory()
    torch.set_num_threads(1)
    variants = [v for v in all_variants() if not options.only or v.name in (*options.only, DEFAULT)]
    print(f"building {len({v.name for v in variants if v.is_built})} kernels", flush=True)
    try:
        kernels = load_variants(variants)
        workload = workload_of(options.run, print) if options.run else make_workload(options.workload)
    except (BuildError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    what = str(options.run or options.workload)
    options.pixels = min(options.pixels, workload.camera.width, workload.camera.height)
    points = measure(
        variants,
        kernels,
        workload,
        workload.cropped(options.pixels),
        options.rounds,
        lambda line: print(line, flush=True),
    )
    typed = sys.argv[1:] if arguments is None else arguments
    made = provenance(" ".join(["python -m pipeline.studies.kernel_precision", *typed]))
    heading = (
        f"{what}, {len(workload.gaussians):,} Gaussians, {workload.camera.width}×{workload.camera.height}, "
        f"instruction set {kernel.__name__.rsplit('_', 1)[1]}; errors of its middle "
        f"{options.pixels}×{options.pixels} pixels. {made['machine']}; {made['date'][:16]}; "
        f"commit {made['git_commit'][:10]}; `{made['command']}`."
    )
    options.out.mkdir(parents=True, exist_ok=True)
    for suffix, content in (
        ("csv", comma_separated(points)),
        ("md", markdown(points, heading)),
        ("svg", draw(points, f"{what}, {made['machine']}, {made['date'][:10]}")),
    ):
        (options.out / f"work_precision.{suffix}").write_text(content, encoding="utf-8")
    print(markdown(points, heading).split("\n- ")[0])
    print("\n".join(verdicts(points)))
    print(f"written to {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
