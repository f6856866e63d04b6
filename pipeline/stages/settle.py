"""Settles a run's configuration once its data are read: the result leaves nothing to decide.

1. The kind of scene chooses the schedule's file: conf/train/<schedule>/<kind>.yaml under the command line.
2. Validation decides what the schedule leaves to it (decide.py): time, and colour that changes in time.
3. What the data determine is filled in: layout, split, source of points, static or not, the background's colour.

The settled configuration is what is written, hashed, trained, evaluated and reported.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from types import MappingProxyType
from typing import Any

from datasets.scene import Scene
from pipeline.config.compose import Command
from pipeline.config.schema import Config
from pipeline.data.prepare import Prepared
from pipeline.model.model import kind_of
from pipeline.runs.run_identity import FREE_KEYS, flat
from pipeline.stages.decide import (
    Comparison,
    colour_is_open,
    compare_colour,
    compare_shared_motion,
    compare_time,
    shared_motion_is_open,
    time_is_open,
)

# What validation decided: {"static": bool, "shared_motion": True, "fourier_order": 0}; each may be missing.
Decided = Mapping[str, Any]
# What decides nothing about the result, or is a column of its own in every table.
NOT_CHANGES = (*FREE_KEYS, "seed", "scene.name", "ablation.name", "train.name", "train.checkpoint_every")


def for_scene(command: Command, data: Prepared, decided: Decided | None = None) -> Config:
    """The command's configuration for these data. decided: None where validation has not decided yet."""
    cfg = _of_kind(command, data, schedule_kind(command.config(), data.scene, decided or {}))
    return cfg if decided is None else _closed(cfg, data.scene, decided)


def _of_kind(command: Command, data: Prepared, kind: str) -> Config:
    cfg = command.config(kind)
    read = replace(data.settings or cfg.scene, background=list(data.scene.background))
    return replace(cfg, scene=read, init=replace(cfg.init, source=data.points))


def schedule_kind(cfg: Config, scene: Scene, decided: Decided = MappingProxyType({})) -> str:
    """Which of a schedule's files applies: static, static_clip, multi_view, clip, shared or unknown (none of them)."""
    if decided.get("static"):
        return "static_clip" if scene.capture == "clip" else "static"
    if kind_of(scene, cfg).motion == "static":
        return "static"
    if scene.several_cameras:
        return "multi_view"
    if scene.capture == "clip":
        return "clip"
    return "shared" if decided.get("shared_motion") else "unknown"


def decide(command: Command, data: Prepared, log: Callable[[str], None]) -> dict[str, Any]:
    """Runs the short trainings that the schedule asks for: {"decided": …, "seconds": …}, and what they compared."""
    cfg, scene = for_scene(command, data), data.scene
    decided: dict[str, Any] = {}
    compared: dict[str, Any] = {}
    if cfg.train.time_budget_s is not None and (cfg.train.select or cfg.scene.may_be_static):
        log("settle: nothing is compared, as all of train.time_budget_s is for the schedule")
    if time_is_open(cfg, scene):
        found = compare_time(cfg, scene, data.cloud, log)
        decided["static"] = found.decidable and not found.beyond_chance
        compared["time"] = asdict(found)
        taken = "static" if decided["static"] else "dynamic"
        log(f"settle: {taken}{_default(found)}: time, {found}; ablation.static=true or false decides otherwise")
    if not decided.get("static") and shared_motion_is_open(cfg, scene):
        shared = _of_kind(command, data, "shared")
        found = compare_shared_motion(cfg, shared, scene, data.cloud, log)
        followed = found.decidable and found.takes_shared_motion
        if followed:
            decided["shared_motion"], cfg = True, shared
        compared["shared_motion"] = asdict(found)
        log(f"settle: shared motion {'taken' if followed else 'left out'}{_default(found)}: {found}")
    if not decided.get("static") and colour_is_open(cfg, scene):
        found = compare_colour(cfg, scene, data.cloud, log)
        if not (kept := found.keeps_colour or not found.decidable):
            decided["fourier_order"] = 0
        compared["time_colour"] = asdict(found)
        log(f"settle: time-varying colour {'kept' if kept else 'left out'}{_default(found)}: {found}")
    spent = {name: sum(c[name] for c in compared.values()) for name in ("seconds", "cpu_seconds")}
    return {"decided": decided, "compared": compared, **spent}


def _default(found: Comparison) -> str:
    """What a line adds where the comparison decides nothing."""
    if found.decidable:
        return ""
    return f" by default, as it is not decidable: neither shows more than a blur ({found.against})"


def changes(command: Command, scene: Scene) -> dict[str, Any]:
    """Dotted key -> value of what the command changed: where scene, schedule and ablation alone give another value."""
    kind = schedule_kind(command.config(), scene)
    given, preset = (flat(asdict(cfg), NOT_CHANGES) for cfg in (command.config(kind), command.preset(kind)))
    scaled = command.scaled_values(kind)  # which follows from train.iterations
    return {key: value for key, value in given.items() if value != preset.get(key) and key not in scaled}


def scaling(command: Command, scene: Scene, decided: Decided) -> str | None:
    """A line on what was scaled with train.iterations; None if nothing was."""
    kind = schedule_kind(command.config(), scene, decided)
    if not (scaled := command.scaled_values(kind)):
        return None
    numbers = command.config(kind).train.iterations, command.preset(kind).train.iterations
    keys = ", ".join(f"{key}={now}".replace(" ", "") for key, (_, now) in scaled.items())
    return f"train.iterations={numbers[0]} of {numbers[1]}: scaled with it are {keys}; a key that is given stays"


def _closed(cfg: Config, scene: Scene, decided: Decided) -> Config:
    """With nothing left to decide: validation's decisions taken, and none asked for any more."""
    if decided.get("static"):
        cfg = replace(cfg, ablation=replace(cfg.ablation, static=True))
    kind = kind_of(scene, cfg)
    order = decided.get("fourier_order", kind.fourier_order)
    return replace(
        cfg,
        scene=replace(cfg.scene, may_be_static=False),
        ablation=replace(cfg.ablation, static=kind.motion == "static", fourier_order=order),
        train=replace(cfg.train, select=False),
    )
