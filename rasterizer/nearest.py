"""The points nearest to some of a set of points in space, by the kernel."""

from __future__ import annotations

import torch
from torch import Tensor

from rasterizer.cores import thread_count
from rasterizer.kernel_loader import kernel
from rasterizer.validation import check_array


def nearest(points: Tensor, rows: Tensor, k: int, threads: int = 0) -> tuple[Tensor, Tensor]:
    """For each of `rows` the `k` points nearest to it, itself among them, nearest first.

    points: (N, C) contiguous float32, of which the first three columns count. rows: (Q,) int64. Returns their rows
    (Q, k) int32 and their distances (Q, k). The same bits for any number of threads. ValueError for other shapes or
    types, rows that are none of N, and k outside 1..N.
    """
    if points.ndim != 2 or points.shape[1] < 3:
        raise ValueError(f"points must be (N, 3) or more columns, got {list(points.shape)}")
    check_array("points", points, torch.float32, points.shape)
    check_array("rows", rows, torch.int64, [rows.numel()])
    if not 1 <= k <= len(points):
        raise ValueError(f"k must be in 1..{len(points)}, the number of points, got {k}")
    if len(rows) and not 0 <= int(rows.min()) <= int(rows.max()) < len(points):
        raise ValueError(f"rows must be in 0..{len(points) - 1}, got {int(rows.min())} to {int(rows.max())}")
    index = torch.empty((len(rows), k), dtype=torch.int32)
    distance = torch.empty((len(rows), k))
    kernel.nearest(points=points, rows=rows, index=index, distance=distance, threads=thread_count(threads))
    return index, distance
