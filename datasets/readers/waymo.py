"""Waymo Open Dataset as other programs leave it: "processed" (EmerNeRF, DriveStudio, S3Gaussian) or in KITTI's format
(Periodic Vibration Gaussian). The layout is recognised by its folders. convert.py makes the first from the
original parquet files."""

from __future__ import annotations

from pathlib import Path

from datasets.files.errors import SceneError
from datasets.settings import SceneConfig
from datasets.source import Log, Source, data_folder
from datasets.urban.assemble import DriveSource
from datasets.urban.log import DrivingLog
from datasets.urban.waymo.kitti_format import open_kitti_format
from datasets.urban.waymo.processed import open_processed


def open_source(cfg: SceneConfig, threads: int, log: Log) -> Source:
    return DriveSource(cfg, open_waymo(data_folder(cfg)), log)


def open_waymo(path: Path) -> DrivingLog:
    """The log of a folder in one of the layouts. SceneError names what is missing."""
    if (path / "ego_pose").is_dir():
        return open_processed(path)
    if (path / "calib").is_dir() and (path / "pose").is_dir():
        return open_kitti_format(path)
    raise SceneError(
        path,
        "a processed Waymo scene (images/, ego_pose/, extrinsics/, intrinsics/) or one in KITTI's format (image_0/, "
        "calib/, pose/)",
        "none of their folders",
    )
