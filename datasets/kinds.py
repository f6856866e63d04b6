"""The kind of scene that a configuration names. It decides which reader the data get and where the poses come from.

photographs     an image at a time, or all of a static scene; poses in the files
posed_videos    several cameras that stand still; poses in the files
videos          the same without poses: structure from motion finds them
clip            the video of one camera that moves; structure from motion finds its poses
clips           videos of several cameras of which some move; likewise
drive           cameras on a car, with LiDAR or without; poses in the files
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

from datasets.files.errors import SceneError
from datasets.settings import SceneConfig

SceneKind = Literal["photographs", "posed_videos", "videos", "clip", "clips", "drive"]
CHOSEN_DOWNSCALE = {"plenoptic": 2}  # readers without a choice by size: their default


def scene_kind(cfg: SceneConfig) -> SceneKind:
    """The kind of a configuration's scene; looks at the files where `scene.reader` is `auto` or `video`."""
    cfg = with_reader(cfg)
    if cfg.reader == "synthetic":
        return _synthetic_kind(cfg)
    if cfg.reader in ("kitti", "waymo"):
        return "drive"
    if cfg.reader == "plenoptic":
        return "posed_videos"
    return _video_kind(cfg) if cfg.reader == "video" else "photographs"


def with_reader(cfg: SceneConfig, log: Callable[[str], None] | None = None) -> SceneConfig:
    """The settings with the layout found out where `scene.reader` is `auto`. log: gets the reasons."""
    if cfg.reader != "auto":
        return cfg
    from datasets.layouts.detect import detect

    found = detect(data_path(cfg))
    if log is not None:
        log(found.line)
    downscale = cfg.downscale or CHOSEN_DOWNSCALE.get(found.reader, 0)
    # What is known to need it: other layouts are read as their files are.
    color = False if cfg.color_correction == "auto" and found.reader != "video" else cfg.color_correction
    cfg = replace(cfg, reader=found.reader, downscale=downscale, color_correction=color)
    return _with_split(cfg, log or (lambda line: None)) if found.reader == "dnerf" else cfg


def _with_split(cfg: SceneConfig, log: Callable[[str], None]) -> SceneConfig:
    """For a folder in D-NeRF's layout without the test split: transforms_val.json, else every eighth training view."""
    from datasets.dnerf import VALIDATION_EVERY, has_split

    path = data_path(cfg)
    if cfg.validation_every or has_split(path, cfg.test_split):
        return cfg
    missing = f"{path}: there is no transforms_{cfg.test_split}.json"
    if has_split(path, "val"):
        log(f"{missing}; held out: transforms_val.json")
        return replace(cfg, test_split="val")
    log(f"{missing}; held out: every {VALIDATION_EVERY}th training view")
    return replace(cfg, validation_every=VALIDATION_EVERY)


def synthetic_name(cfg: SceneConfig) -> str:
    """The name of a synthetic scene without its group: "wheel" of "synthetic/wheel"."""
    return cfg.name.rpartition("/")[2]


def data_path(cfg: SceneConfig) -> Path:
    """`scene.path`; SceneError without one."""
    if cfg.path is None:
        raise SceneError("scene.path", "the folder of the data (scene.path=DIR)", "none")
    return Path(cfg.path).expanduser()


def _synthetic_kind(cfg: SceneConfig) -> SceneKind:
    from datasets.synthetic import DRIVEN, FILMED

    name = synthetic_name(cfg)
    return "drive" if name in DRIVEN else "posed_videos" if name in FILMED else "photographs"


def _video_kind(cfg: SceneConfig) -> SceneKind:
    from datasets.clip import cameras_move, is_clip

    path = data_path(cfg)
    if is_clip(path):
        return "clip"
    if cfg.moving_cameras and cameras_move(path, cfg.drop_cameras, assumed=cfg.moving_cameras is True):
        return "clips"
    return "videos"
