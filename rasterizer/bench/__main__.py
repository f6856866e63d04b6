"""How fast the kernel is.

python -m rasterizer.bench W1                 stages, bound, one and two threads
python -m rasterizer.bench W1 W2h W2 --all    also a training iteration, the loss, the readable twin; a roofline plot
python -m rasterizer.bench W1 --parts         what each part of the model and each output costs
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import signal
import sys
from dataclasses import asdict
from pathlib import Path

import torch

from rasterizer.bench.bound import Rates, Work, bound_ms, measure_rates, work_of
from rasterizer.cores import usable_cores
from rasterizer.kernel import kernel
from rasterizer.memory import keep_freed_memory
from rasterizer.timing.measure import (
    Counts,
    FrameTime,
    Time,
    clock_for,
    count,
    time_frame,
    time_iteration,
    time_loss,
    time_parts,
    time_reference,
)
from rasterizer.timing.workloads import WORKLOADS, Workload, make_workload

TWIN_PIXELS = 24
LOSS_PIXELS = 400


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m rasterizer.bench", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("workloads", nargs="+", choices=WORKLOADS, metavar="workload", help=", ".join(WORKLOADS))
    parser.add_argument(
        "--isa", choices=("v2", "v3", "v4", "plain"), help="instruction set (default: the best there is)"
    )
    parser.add_argument("--threads", type=int, nargs="+", help="default: 1, and 2 where the machine has them")
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--parts", action="store_true", help="what each part costs when on")
    parser.add_argument("--all", action="store_true", help="also a training iteration, the loss and the readable twin")
    parser.add_argument("--plot", type=Path, help="write a roofline plot here (with --all: results/bench/roofline.png)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return parser.parse_args()


def main() -> None:
    options = parse()
    if options.isa and os.environ.get("RASTERIZER_ISA") != options.isa:
        # The kernel is chosen when the package is imported, which has happened by now: start again.
        environment = os.environ | {"RASTERIZER_ISA": options.isa}
        os.execve(sys.executable, [sys.executable, "-m", "rasterizer.bench", *sys.argv[1:]], environment)
    plot = options.plot or (Path("results/bench/roofline.png") if options.all else None)
    if plot and importlib.util.find_spec("matplotlib") is None:  # told before minutes of measuring
        sys.exit("error: --plot and --all draw with matplotlib, which is not installed: pip install matplotlib")
    keep_freed_memory()
    torch.set_num_threads(1)
    threads = options.threads or list(range(1, min(2, usable_cores()) + 1))
    say = (lambda *lines: None) if options.json else print
    found: dict = {"isa": kernel.__name__.rsplit("_", 1)[1], "repeats": options.repeats, "workloads": {}}
    say(f"instruction set {found['isa']}, fastest of {options.repeats} (median)")
    if options.parts:
        for name in options.workloads:
            found["workloads"][name] = parts(name, threads[0], options.repeats, say)
    else:
        rates = measure_rates()
        found["rates"] = asdict(rates)
        say(
            f"this machine, one thread: {rates.operations / 1e9:.0f} G multiply-adds/s, copies {rates.bytes / 1e9:.1f} GB/s"
        )
        measured = {}
        for name in options.workloads:
            workload = make_workload(name)
            found["workloads"][name], measured[name] = frames(name, workload, threads, options.repeats, rates, say)
            if options.all:
                found["workloads"][name] |= beyond_frames(workload, threads, options.repeats, say)
        if options.all:
            found["loss"] = loss(options.repeats, say)
        if plot and 1 in threads:
            from rasterizer.bench.roofline import write_roofline

            write_roofline(plot, rates, measured)
            say(f"roofline: {plot}")
        if len(measured) == 1:
            found |= in_short(options.workloads[0], found["workloads"][options.workloads[0]]["threads"])
    if options.json:
        print(json.dumps(found))


def in_short(name: str, times: dict[str, dict]) -> dict:
    """One workload's fastest times for scripts, at the first number of threads: flat, milliseconds."""
    threads, time = next(iter(times.items()))
    whole = {f"{part}_ms": time[part]["minimum"] for part in ("forward", "backward", "total", "expand_sh")}
    return {
        "workload": name,
        "threads": int(threads),
        **whole,
        "stages": {stage: ms["minimum"] for stage, ms in time["stages"].items()},
    }


def shown(time: Time) -> str:
    return f"{time.minimum:8.2f} ({time.median:.2f})"


def frames(
    name: str, workload: Workload, threads: list[int], repeats: int, rates: Rates, say
) -> tuple[dict, tuple[dict[str, Work], dict[str, float]]]:
    """Forward and backward at each number of threads. Returns what to print as JSON, and what the plot needs."""
    counts = count(workload)
    times = {n: time_frame(workload, n, repeats) for n in threads}
    work = work_of(counts, sh_bytes=4 * workload.gaussians.sh[0].numel())
    bound = bound_ms(work, rates)
    say_counts(name, counts, say)
    for n, time in times.items():
        say(f"  {n} thread{'s' if n > 1 else ''}, {time.clock} time, ms")
        for stage, ms in time.stages.items():
            say(f"    {stage:<18} {shown(ms)}")
        say(f"    {'forward':<18} {shown(time.forward)}    backward {shown(time.backward)}")
        say(
            f"    {'total':<18} {shown(time.total)}    the SH gradient written out, as training never does: "
            f"+ {shown(time.expand_sh).strip()}"
        )
    if 1 in times:
        say(f"  bound {bound:.2f} ms: the total is {times[1].total.minimum / bound:.2f} times it")
        if 2 in times:
            say(f"  two threads: {times[1].total.minimum / times[2].total.minimum:.2f} times as fast")
    stages = {stage: ms.minimum for stage, ms in times[threads[0]].stages.items()}
    result = {
        "counts": asdict(counts),
        "bound_ms": round(bound, 3),
        "threads": {str(n): asdict(time) for n, time in times.items()},
    }
    return result, (work, stages)


def say_counts(name: str, c: Counts, say) -> None:
    say(
        f"{name}: {c.visible:,} of {c.gaussians:,} Gaussians visible, {c.entries:,} tile entries, "
        f"{c.pairs / 1e6:.2f} M pairs evaluated, {c.contributing / 1e6:.2f} M contributing"
    )


def beyond_frames(workload: Workload, threads: list[int], repeats: int, say) -> dict:
    found = {}
    for sparse, label in ((False, "adam"), (True, "sparse_adam")):
        for n in threads:
            parts = time_iteration(workload, n, repeats, sparse=sparse)
            found[f"iteration_{label}_{n}"] = {part: asdict(time) for part, time in parts.items()}
            ratio = parts["iteration"].minimum / parts["rasterizer"].minimum
            say(
                f"  training iteration, 4 views, {label}, {n} thread{'s' if n > 1 else ''}: "
                f"{parts['iteration'].minimum:.1f} ms {clock_for(n)[0]} = {ratio:.2f} times its rasterizer calls "
                f"(loss {parts['loss'].minimum:.1f}, Adam {parts['adam'].minimum:.1f})"
            )
    ours, twin = time_reference(workload, TWIN_PIXELS)
    found["crop"] = {"pixels": TWIN_PIXELS, "kernel": asdict(ours), "twin": asdict(twin)}
    say(
        f"  the middle {TWIN_PIXELS}×{TWIN_PIXELS} pixels: kernel {ours.minimum:.2f} ms, readable twin "
        f"{twin.minimum:.0f} ms, {twin.minimum / ours.minimum:.0f} times as long"
    )
    return found


def loss(repeats: int, say) -> dict:
    ours, in_torch = time_loss(LOSS_PIXELS, repeats)
    say(
        f"L1 + SSIM, {LOSS_PIXELS}×{LOSS_PIXELS}, forward and backward, one thread: {ours.minimum:.2f} ms; torch's conv2d "
        f"{in_torch.minimum:.1f} ms, {in_torch.minimum / ours.minimum:.0f} times as long"
    )
    return {"kernel": asdict(ours), "torch": asdict(in_torch)}


def parts(name: str, threads: int, repeats: int, say) -> dict:
    rows: dict[str, tuple[int, FrameTime]] = time_parts(make_workload(name), threads, repeats)
    say(f"{name}, {threads} thread{'s' if threads > 1 else ''}, ms; SH gradients compact")
    for label, (visible, time) in rows.items():
        say(
            f"  {label:<46} {visible:6} visible  forward {time.forward.minimum:7.2f}  "
            f"backward {time.backward.minimum:7.2f}  total {time.total.minimum:7.2f}"
        )
    return {label: {"visible": visible} | asdict(time) for label, (visible, time) in rows.items()}


if __name__ == "__main__":
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # `… | head` ends it without a word
    main()
