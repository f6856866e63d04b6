"""Columns of moving pixels, foreground, optical flow and depth, for the tables that have those of any run."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from pipeline.presentation.table import Column


@dataclass(frozen=True)
class MotionColumn:
    """One number of a run, of its last iteration."""

    key: str
    header: str
    metric: str  # column of Collection.runs
    decimals: int

    @property
    def column(self) -> Column:
        return Column(self.key, self.header, group="motion")


_COLUMNS = (
    MotionColumn("final_moving", "PSNR ↑ moving", "final.psnr_moving", 2),
    MotionColumn("final_still", "PSNR ↑ still", "final.psnr_still", 2),
    MotionColumn("final_foreground", "PSNR ↑ foreground", "final.psnr_foreground", 2),
    MotionColumn("final_masked", "PSNR ↑ masked", "final.psnr_masked", 2),
    MotionColumn("flow_error", "Flow error ↓", "final.flow_error", 3),
    MotionColumn("flow_error_px", "Flow error ↓, px", "final.flow_error_px", 2),
    MotionColumn("depth_error", "Depth error ↓", "final.depth_error_median", 4),
    MotionColumn("lidar_error", "LiDAR error ↓", "final.lidar_error_median", 4),
    MotionColumn("lidar_error_mean", "LiDAR AbsRel ↓", "final.lidar_error_mean", 4),
    MotionColumn("lidar_rmse", "LiDAR RMSE ↓, m", "final.lidar_rmse", 2),
)
NOTE = (
    "",
    "All final. Moving: pixels of bodies that move, where they are known, else those whose true colour changes by more "
    "than 0.1 before a still camera; still: all others. Foreground: alpha > 0. Flow error: mean end-point error over "
    "moving pixels as a share of their mean true motion. Depth error: median of |z − truth| / truth. LiDAR: the "
    "same of held-out sweeps' points, its mean (AbsRel), and the root mean square of z − truth.",
)


def motion_columns(runs: pd.DataFrame) -> tuple[MotionColumn, ...]:
    """Those that any of the runs has a number for."""
    return tuple(column for column in _COLUMNS if runs[column.metric].notna().any())
