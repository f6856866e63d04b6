"""Stages select_motion and select_time_colour: which parts of the model a scene needs, decided by validation."""

from __future__ import annotations

from dataclasses import asdict

from pipeline.config.schema import Config
from pipeline.data.prepared import Prepared
from pipeline.runs.run_folder import RunFolder
from pipeline.stages.stage import Log
from pipeline.training.selection import motion, time_colour
from rasterizer.cores import thread_count

MOTION = "select_motion"  # the stage, and what metrics.json has of it
TIME_COLOUR = "select_time_colour"  # likewise


def decide_motion(cfg: Config, data: Prepared, folder: RunFolder, log: Log) -> dict:
    """scene and points → whether the model has time at all."""
    selection = motion.select_motion(data.scene, cfg, data.cloud, thread_count(cfg.threads), log)
    log(f"{MOTION}: {selection}")
    return asdict(selection)


def decide_time_colour(cfg: Config, data: Prepared, folder: RunFolder, log: Log) -> dict:
    """scene and points → whether the model has time-varying colour; nothing where it has no time."""
    if (decided := motion_of(folder)) and not decided.dynamic:
        return {}
    selection = time_colour.select(data.scene, cfg, data.cloud, thread_count(cfg.threads), log)
    log(f"{TIME_COLOUR}: {selection}")
    return asdict(selection)


def motion_of(folder: RunFolder) -> motion.MotionSelection | None:
    """The run's decision between static and dynamic; None where there was none to take."""
    return motion.MotionSelection(**folder.values_of(MOTION)) if folder.inputs_of(MOTION) else None


def time_colour_of(folder: RunFolder) -> time_colour.Selection | None:
    """The run's selection of time-varying colour; None where it had none."""
    found = folder.values_of(TIME_COLOUR) if folder.inputs_of(TIME_COLOUR) else None
    return time_colour.Selection(**found) if found else None


def as_decided(cfg: Config, data: Prepared, folder: RunFolder) -> Config:
    """The configuration of the model that select_motion decided for."""
    decided = motion_of(folder)
    return cfg if decided is None or decided.dynamic else motion.without_time(cfg, data.scene)
