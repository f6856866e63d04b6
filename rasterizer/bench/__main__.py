"""Benchmark of the kernel.

python -m rasterizer.bench W1                 stages, lower bound, one and two threads
python -m rasterizer.bench W1 W2h W2 --all    also a training iteration, the loss, the reference implementation, a plot
python -m rasterizer.bench W1 --parts         cost of each part of the model and of each output
python -m rasterizer.bench W2 --scaling       growth of the cost with Gaussians, pixels, views and threads
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import signal
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import torch

from rasterizer.bench.baselines import time_loss, time_parts, time_reference
from rasterizer.bench.frame_time import (
    FrameTime,
    Time,
    WorkCounts,
    clock_for,
    count_work,
    time_batch,
    time_frame,
    time_iteration,
)
from rasterizer.bench.roofline import Rates, Work, bound_ms, measure_rates, work_of, write_roofline
from rasterizer.bench.scaling import measure_growth, measure_threads, simulated_waiting
from rasterizer.bench.workloads import WORKLOADS, Workload, make_workload
from rasterizer.cores import keep_freed_memory, usable_cores
from rasterizer.kernel_loader import ISA_VARIABLE, kernel, source_hash

REFERENCE_PIXELS = 24
LOSS_PIXELS = 400
ROOFLINE_FILE = Path("results/bench/roofline.png")

Log = Callable[[str], None]


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m rasterizer.bench", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("workloads", nargs="+", choices=WORKLOADS, metavar="workload", help=", ".join(WORKLOADS))
    parser.add_argument("--isa", choices=("v2", "v3", "v4", "plain"), help="instruction set (default: the best one)")
    parser.add_argument("--threads", type=int, nargs="+", help="default: 1, and 2 where the machine has them")
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--parts", action="store_true", help="cost of each part of the model and of each output")
    parser.add_argument("--scaling", action="store_true", help="growth of the cost with the size of the problem")
    parser.add_argument(
        "--all", action="store_true", help="also a training iteration, the loss and the reference implementation"
    )
    parser.add_argument("--plot", type=Path, help=f"write a roofline plot here (with --all: {ROOFLINE_FILE})")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    if sum((options.parts, options.scaling, bool(options.plot or options.all))) > 1:
        parser.error("--parts, --scaling: expected one of them, and neither --plot nor --all beside it")
    if options.scaling and options.threads:
        parser.error("--threads: expected none beside --scaling, which measures several")
    if (options.plot or options.all) and options.threads and 1 not in options.threads:
        parser.error("--threads: expected 1 among them for --plot and --all, whose roofline is of one thread")
    if options.repeats < 1:
        parser.error(f"--repeats: expected at least 1, found {options.repeats}")
    return options


def main() -> None:
    options = parse()
    if options.isa and os.environ.get(ISA_VARIABLE) != options.isa:
        # The kernel was chosen when the package was imported: restart.
        environment = os.environ | {ISA_VARIABLE: options.isa}
        os.execve(sys.executable, [sys.executable, "-m", "rasterizer.bench", *sys.argv[1:]], environment)
    plot = options.plot or (ROOFLINE_FILE if options.all else None)
    if plot and importlib.util.find_spec("matplotlib") is None:  # before minutes of measuring
        sys.exit("error: --plot and --all draw with matplotlib, which is not installed: pip install matplotlib")
    keep_freed_memory()
    torch.set_num_threads(1)
    threads = options.threads or list(range(1, min(2, usable_cores()) + 1))
    log = (lambda line: None) if options.json else print
    isa = kernel.__name__.rsplit("_", 1)[1]
    result: dict = {"isa": isa, "kernel": source_hash(), "repeats": options.repeats, "workloads": {}}
    log(f"instruction set {isa}, fastest of {options.repeats} (median); kernel {source_hash()}")
    if options.parts:
        for name in options.workloads:
            result["workloads"][name] = measure_parts(name, threads[0], options.repeats, log)
    elif options.scaling:
        for name in options.workloads:
            result["workloads"][name] = measure_scaling(name, options.repeats, log)
    else:
        result |= measure_workloads(options, threads, plot, log)
    if options.json:
        print(json.dumps(result))


def measure_workloads(options: argparse.Namespace, threads: list[int], plot: Path | None, log: Log) -> dict:
    """Frames of each workload against the lower bound; with --all the rest too."""
    rates = measure_rates()
    log(
        f"this machine, one thread: {rates.operations / 1e9:.0f} G multiply-adds/s, "
        f"memory {rates.bytes / 1e9:.1f} GB/s read plus written"
    )
    result: dict = {"rates": asdict(rates), "workloads": {}}
    roofline = {}
    for name in options.workloads:
        workload = make_workload(name)
        frames, roofline[name] = measure_frames(name, workload, threads, options.repeats, rates, log)
        if options.all:
            frames |= measure_iteration_and_reference(workload, threads, options.repeats, log)
        result["workloads"][name] = frames
    if options.all:
        result["loss"] = measure_loss(options.repeats, log)
    if plot:
        write_roofline(plot, rates, roofline)
        log(f"roofline: {plot}")
    if len(options.workloads) == 1:
        (name,) = options.workloads
        result |= summary(name, result["workloads"][name]["threads"])
    return result


def summary(name: str, times: dict[str, dict]) -> dict:
    """One workload's fastest times in milliseconds at the first number of threads, flat, for scripts."""
    threads, time = next(iter(times.items()))
    whole = {f"{part}_ms": time[part]["minimum"] for part in ("forward", "backward", "total", "expand_sh")}
    return {
        "workload": name,
        "threads": int(threads),
        **whole,
        "stages": {stage: ms["minimum"] for stage, ms in time["stages"].items()},
    }


def measure_frames(
    name: str, workload: Workload, threads: list[int], repeats: int, rates: Rates, log: Log
) -> tuple[dict, tuple[dict[str, Work], dict[str, float]]]:
    """Forward and backward at each number of threads: the JSON result, and (work, milliseconds) by stage to plot."""
    counts = count_work(workload)
    times = {n: time_frame(workload, n, repeats) for n in threads}
    work = work_of(counts, sh_bytes=4 * workload.gaussians.sh[0].numel())
    bound = bound_ms(work, rates)
    log_frames(name, counts, times, bound, log)
    stages = {stage: ms.minimum for stage, ms in times[1 if 1 in times else threads[0]].stages.items()}
    result = {
        "counts": asdict(counts),
        "bound_ms": round(bound, 3),
        "threads": {str(n): asdict(time) for n, time in times.items()},
    }
    return result, (work, stages)


def log_frames(name: str, c: WorkCounts, times: dict[int, FrameTime], bound: float, log: Log) -> None:
    log(
        f"{name}: {c.visible:,} of {c.gaussians:,} Gaussians visible, {c.intersections:,} tile intersections, "
        f"{c.pairs / 1e6:.2f} M (pixel, Gaussian) pairs evaluated, {c.contributing / 1e6:.2f} M contributing"
    )
    for n, time in times.items():
        log(f"  {plural(n)}, {time.clock} time, ms")
        for stage, ms in time.stages.items():
            log(f"    {stage:<20} {shown(ms)}")
        log(f"    {'forward':<20} {shown(time.forward)}    backward {shown(time.backward)}")
        log(
            f"    {'total':<20} {shown(time.total)}    expanding the SH gradient, which training never does: "
            f"+ {shown(time.expand_sh).strip()}"
        )
    if 1 in times:
        log(f"  lower bound {bound:.2f} ms: the total is {times[1].total.minimum / bound:.2f} times it")
        if 2 in times:
            log(f"  two threads: {times[1].total.minimum / times[2].total.minimum:.2f} times as fast")


def measure_iteration_and_reference(workload: Workload, threads: list[int], repeats: int, log: Log) -> dict:
    result: dict[str, dict] = {}
    for n in threads:
        together, alone = time_batch(workload, n, repeats)
        result[f"batch_{n}"] = {"together": asdict(together), "one_by_one": asdict(alone)}
        log(
            f"  4 views forward, {plural(n)}: {together.minimum:.1f} ms {clock_for(n)[0]} together, "
            f"{alone.minimum:.1f} ms one by one"
        )
    for sparse, label in ((False, "adam"), (True, "sparse_adam")):
        for n in threads:
            parts = time_iteration(workload, n, repeats, sparse=sparse)
            result[f"iteration_{label}_{n}"] = {part: asdict(time) for part, time in parts.items()}
            ratio = parts["iteration"].minimum / parts["rasterizer"].minimum
            log(
                f"  training iteration, 4 views, {label}, {plural(n)}: "
                f"{parts['iteration'].minimum:.1f} ms {clock_for(n)[0]} = {ratio:.2f} times its rasterizer calls "
                f"(loss {parts['loss'].minimum:.1f}, Adam {parts['adam'].minimum:.1f})"
            )
    ours, reference = time_reference(workload, REFERENCE_PIXELS)
    result["crop"] = {"pixels": REFERENCE_PIXELS, "kernel": asdict(ours), "reference": asdict(reference)}
    log(
        f"  the middle {REFERENCE_PIXELS}×{REFERENCE_PIXELS} pixels: kernel {ours.minimum:.2f} ms, reference "
        f"implementation {reference.minimum:.0f} ms, {reference.minimum / ours.minimum:.0f} times as long"
    )
    return result


def measure_loss(repeats: int, log: Log) -> dict:
    ours, in_torch = time_loss(LOSS_PIXELS, repeats)
    log(
        f"L1 + SSIM, {LOSS_PIXELS}×{LOSS_PIXELS}, forward and backward, one thread: {ours.minimum:.2f} ms; torch's "
        f"conv2d {in_torch.minimum:.1f} ms, {in_torch.minimum / ours.minimum:.0f} times as long"
    )
    return {"kernel": asdict(ours), "torch": asdict(in_torch)}


def measure_parts(name: str, threads: int, repeats: int, log: Log) -> dict:
    rows = time_parts(make_workload(name), threads, repeats)
    log(f"{name}, {plural(threads)}, ms; SH gradients compact")
    for label, (visible, time) in rows.items():
        log(
            f"  {label:<46} {visible:6} visible  forward {time.forward.minimum:7.2f}  "
            f"backward {time.backward.minimum:7.2f}  total {time.total.minimum:7.2f}"
        )
    return {label: {"visible": visible} | asdict(time) for label, (visible, time) in rows.items()}


def measure_scaling(name: str, repeats: int, log: Log) -> dict:
    workload = make_workload(name)
    log(f"{name}: a training iteration, 4 views, adam, 1 thread, ms cpu; exponent from the size before")
    growth = measure_growth(workload, repeats)
    for found in growth:
        steps = zip(found.sizes[1:], found.ms[1:], found.exponents, strict=True)
        rest = "".join(f", {size:,}: {ms:.1f} ({exponent:.2f})" for size, ms, exponent in steps)
        log(f"  {found.what:<9}  {found.sizes[0]:,}: {found.ms[0]:.1f}{rest}")
    threads = measure_threads(workload, repeats)
    one = threads[0][1].minimum
    log(
        "  a view forward and backward, cpu time of all threads together over that of one: "
        + ", ".join(f"{n} threads {time.minimum / one:.2f}" for n, time in threads[1:])
    )
    waiting = simulated_waiting(workload, min(3, repeats))
    log(
        "  blending, both passes, share of the threads' time that they wait, simulated: "
        + ", ".join(f"{n} threads {share:.3f}" for n, share in waiting)
    )
    return {
        "growth": [asdict(found) for found in growth],
        "threads": {n: asdict(time) for n, time in threads},
        "waiting": dict(waiting),
    }


def shown(time: Time) -> str:
    return f"{time.minimum:8.2f} ({time.median:.2f})"


def plural(threads: int) -> str:
    return f"{threads} thread{'s' if threads > 1 else ''}"


if __name__ == "__main__":
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # `… | head` ends the program quietly
    main()
