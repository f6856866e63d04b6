"""The cost of each part of the model and of each output: frame times with the part left out or added."""

from __future__ import annotations

from dataclasses import replace

from rasterizer import Gaussians
from rasterizer.timing.frame_time import FrameTime, count_work, time_frame
from rasterizer.timing.workloads import Workload

EXTRA_OUTPUTS = (("alpha",), ("depth",), ("flow",), ("stats",), ("alpha", "depth", "flow", "stats"))


def time_parts(workload: Workload, threads: int, repeats: int) -> dict[str, tuple[int, FrameTime]]:
    """(number of visible Gaussians, time) by label."""
    rows = {}
    for label, model in reduced_models(workload.gaussians).items():
        reduced = replace(workload, gaussians=model)
        rows[label] = count_work(reduced).visible, time_frame(reduced, threads, repeats)
    visible = count_work(workload).visible
    for extra in EXTRA_OUTPUTS:
        flow_dt = 0.01 if "flow" in extra else None
        time = time_frame(workload, threads, repeats, outputs=("color", *extra), flow_dt=flow_dt)
        rows[f"full model + {', '.join(extra)}"] = visible, time
    return rows


def reduced_models(g: Gaussians) -> dict[str, Gaussians]:
    """The full model `g` (16 spherical harmonics, Fourier order 2) and the same Gaussians without some parts."""
    orders = {n: g.sh[:, : 16 * (n + 1)].contiguous() for n in range(3)}
    xyz, scale = g.mean[:, :3].contiguous(), g.log_scale[:, :3].contiguous()
    return {
        "full model, colour only": g,
        "without Fourier order 2": replace(g, sh=orders[1]),
        "without 4DSH": replace(g, sh=orders[0]),
        "without 4D rotation": replace(g, quat_right=None),
        "without 4D rotation and 4DSH": replace(g, quat_right=None, sh=orders[0]),
        "static: no time at all (all Gaussians alive)": Gaussians(
            xyz, scale, g.quat_left, None, g.opacity_logit, orders[0]
        ),
    }
