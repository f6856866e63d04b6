"""Data sets: one reader per layout on disk, each of which returns a `Scene`; load_scene chooses it by the config."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from datasets.composition import BLACK, WHITE, Color, as_color
from datasets.files.errors import SceneError
from datasets.scene import Scene, View, validate_scene
from datasets.settings import LAYOUTS, SceneConfig
from datasets.validation import hold_out_every, hold_out_outermost

if TYPE_CHECKING:  # imports a video decoder, which other scenes do not need
    from datasets.clip import Clip, ClipOptions, ClipSet
    from datasets.plenoptic import Footage, PosedFootage

__all__ = [
    "Footage",
    "Scene",
    "SceneError",
    "View",
    "is_drive",
    "is_filmed",
    "load_clip",
    "load_clip_set",
    "load_footage",
    "load_posed",
    "load_scene",
    "reads_clip",
    "reads_clip_set",
    "validate_scene",
    "with_reader",
]

Log = Callable[[str], None]  # called with a line of text for the user


def load_scene(cfg: SceneConfig, *, threads: int = 0, log: Log = print) -> Scene:
    """The scene of a config. Synthetic scenes are made and videos are decoded first, unless they are in the cache.

    threads: for decoding; 0: all cores. Raises SceneError for invalid data, and for the reader `video`, whose cameras
    are known only after structure from motion (see load_footage).
    """
    cfg = with_reader(cfg)
    if is_filmed(cfg):
        return load_posed(cfg, threads=threads, log=log).to_scene()
    if is_drive(cfg):
        return _read_drive(cfg, log)
    scene = _read_photographs(cfg, log)
    if not cfg.validation_every:
        return scene
    hold_out = hold_out_outermost if cfg.validation_outermost else hold_out_every
    return validate_scene(hold_out(scene, cfg.validation_every))


def is_drive(cfg: SceneConfig) -> bool:
    """Whether the scene is a driving log: cameras on a car, with LiDAR or without."""
    if cfg.reader == "synthetic":
        from datasets.synthetic import DRIVEN

        return _synthetic_name(cfg) in DRIVEN
    return cfg.reader in ("kitti", "waymo")


def _read_drive(cfg: SceneConfig, log: Log) -> Scene:
    from datasets.urban import open_log
    from datasets.urban.assemble import scene_of_log

    if cfg.reader == "synthetic":
        return scene_of_log(open_log("waymo", _make_synthetic(cfg, log)), cfg, log)
    return scene_of_log(open_log(cfg.reader, _path(cfg)), cfg, log)


def with_reader(cfg: SceneConfig, log: Log | None = None) -> SceneConfig:
    """The settings with the layout found out where scene.reader=auto. log: gets the reasons."""
    if cfg.reader != "auto":
        return cfg
    from datasets.layouts.detect import detect

    found = detect(_path(cfg))
    if log is not None:
        log(found.line)
    chosen = {"dnerf": 2, "plenoptic": 2}  # readers without a choice by size: their default
    downscale = cfg.downscale or chosen.get(found.reader, 0)
    # What is known to need it: other layouts are read as their files are.
    color = False if cfg.color_correction == "auto" and found.reader != "video" else cfg.color_correction
    return replace(cfg, reader=found.reader, downscale=downscale, color_correction=color)


def _read_photographs(cfg: SceneConfig, log: Log) -> Scene:
    """Calls the reader of cfg.reader. A new reader gets its branch here; its module is imported only when needed."""
    if cfg.reader in LAYOUTS:
        from datasets.layouts import LayoutOptions, read_layout

        options = LayoutOptions(
            cfg.name,
            cfg.downscale,
            cfg.test_every,
            cfg.test_cameras,
            cfg.first_frame,
            cfg.frames,
            background_color(cfg.background),
            log,
        )
        return read_layout(cfg.reader, _path(cfg), options)
    from datasets.dnerf import has_split, read_dnerf

    path = _make_synthetic(cfg, log) if cfg.reader == "synthetic" else _path(cfg)
    # With a validation split a scene needs no test split.
    split = None if cfg.validation_every and not has_split(path, cfg.test_split) else cfg.test_split
    return read_dnerf(
        path,
        name=cfg.name,
        test_split=split,
        downscale=cfg.downscale,
        background=background_color(cfg.background),
        init_box=(cfg.init_box[0], cfg.init_box[1]),
        log=log,
    )


def reads_clip(cfg: SceneConfig) -> bool:
    """Whether the scene is one clip by a camera that moves, whose cameras structure from motion finds."""
    cfg = with_reader(cfg)
    if cfg.reader != "video" or cfg.path is None:
        return False
    from datasets.clip import is_clip

    return is_clip(_path(cfg))


def load_clip(cfg: SceneConfig, log: Log = print) -> Clip:
    """The clip of a config: its frames in use, without cameras."""
    from datasets.clip import open_clip

    _refuse_validation(cfg, "clips (scene.test_every holds out other frames)")
    return open_clip(_path(cfg), _clip_options(cfg, log))


def reads_clip_set(cfg: SceneConfig) -> bool:
    """Whether the scene is several cameras of which some move, whose poses structure from motion finds."""
    cfg = with_reader(cfg)
    if cfg.reader != "video" or not cfg.moving_cameras or cfg.path is None or reads_clip(cfg):
        return False
    from datasets.clip import cameras_move

    return cameras_move(_path(cfg), cfg.drop_cameras, assumed=cfg.moving_cameras is True)


def load_clip_set(cfg: SceneConfig, log: Log = print) -> ClipSet:
    """The clips of several cameras of which some move: their frames in use, without poses."""
    from datasets.clip import SetOptions, open_clip_set

    _refuse_validation(cfg, "clips (scene.test_every and scene.test_cameras hold out other views)")
    options = _clip_options(cfg, log)
    # [0] is the default of cameras that stand still; of those that move every frame is a view of its own.
    whole = cfg.test_every == 0 or list(cfg.test_cameras) != [0]
    settings = SetOptions(
        test_cameras=tuple(cfg.test_cameras) if whole else (),
        drop_cameras=tuple(cfg.drop_cameras),
        sync=cfg.sync,
        offsets=tuple(cfg.offsets),
        still=cfg.moving_cameras is not True,
    )
    return open_clip_set(_path(cfg), options, settings)


def _clip_options(cfg: SceneConfig, log: Log) -> ClipOptions:
    from datasets.clip import ClipOptions

    return ClipOptions(
        cfg.name,
        cfg.downscale,
        cfg.frames,
        cfg.first_frame,
        cfg.test_every,
        log,
        background_color(cfg.background) or BLACK,
    )


def background_color(setting: str | Sequence[float]) -> Color | None:
    """scene.background as RGB in [0, 1]; None for auto."""
    if isinstance(setting, str):
        return {"auto": None, "black": BLACK, "white": WHITE}[setting]
    return as_color(setting)


def load_posed(cfg: SceneConfig, *, threads: int = 0, log: Log = print) -> PosedFootage:
    """Multi-camera videos with known poses, checked but not decoded; PosedFootage.to_scene decodes them."""
    if cfg.reader == "video" or not is_filmed(cfg):
        raise SceneError(
            "scene.reader",
            "several cameras with known poses: plenoptic, or a synthetic scene of that kind",
            repr(cfg.reader),
        )
    from datasets.plenoptic import open_plenoptic

    options = _footage_options(cfg, threads, log)
    path = _make_synthetic(cfg, log) if cfg.reader == "synthetic" else _path(cfg)
    return open_plenoptic(path, **options)


def load_footage(cfg: SceneConfig, *, threads: int = 0, log: Log = print) -> Footage:
    """The videos of a config, checked but not decoded: enough to estimate the cost of a run.

    With the reader `video` cameras come from structure from motion later; Footage.to_scene takes them.
    """
    cfg = with_reader(cfg)
    if cfg.reader == "video":
        from datasets.plenoptic import read_footage

        return read_footage(_path(cfg), **_footage_options(cfg, threads, log))
    return load_posed(cfg, threads=threads, log=log).footage


def is_filmed(cfg: SceneConfig) -> bool:
    """Whether the scene consists of multi-camera videos: frames are decoded into a store, points come from COLMAP."""
    cfg = with_reader(cfg)
    if cfg.reader == "synthetic":
        from datasets.synthetic import FILMED

        return _synthetic_name(cfg) in FILMED
    return cfg.reader == "plenoptic" or (cfg.reader == "video" and not reads_clip(cfg) and not reads_clip_set(cfg))


def __getattr__(name: str) -> Any:
    if name == "Footage":  # imported on first use: it needs a video decoder
        from datasets.plenoptic import Footage

        return Footage
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def _make_synthetic(cfg: SceneConfig, log: Log) -> Path:
    from datasets.synthetic import DRIVEN, make_scene

    what = "frames" if _synthetic_name(cfg) in DRIVEN else "cameras"
    return make_scene(
        _synthetic_name(cfg),
        cfg.cache,
        seed=cfg.seed,
        size=cfg.size,
        train_views=cfg.train_views,
        test_views=cfg.test_views,
        cameras=cfg.cameras,
        frames=cfg.frames,
        layout=cfg.layout,
        progress=lambda done, total: log(f"{cfg.name}: {done} of {total} {what} rendered"),
    )


def _synthetic_name(cfg: SceneConfig) -> str:
    return cfg.name.rpartition("/")[2]


def _refuse_validation(cfg: SceneConfig, footage: str) -> None:
    """SceneError for scene.validation_every, which is for photographs with poses."""
    if cfg.validation_every:
        raise SceneError("scene.validation_every", f"0 for {footage}", str(cfg.validation_every))


def _footage_options(cfg: SceneConfig, threads: int, log: Log) -> dict[str, Any]:
    """The fields of plenoptic.FootageOptions."""
    _refuse_validation(cfg, f"the multi-camera videos of {cfg.name} (scene.test_cameras holds out another camera)")
    return {
        "name": cfg.name,
        "downscale": cfg.downscale,
        "test_cameras": cfg.test_cameras,
        "drop_cameras": cfg.drop_cameras,
        "first_frame": cfg.first_frame,
        "frames": cfg.frames,
        "cache": cfg.cache,
        "background": background_color(cfg.background) or BLACK,
        "threads": threads,
        "log": log,
        "sync": cfg.sync,
        "offsets": tuple(cfg.offsets),
    }


def _path(cfg: SceneConfig) -> Path:
    if cfg.path is None:
        raise SceneError("scene.path", "the folder of the data (scene.path=DIR)", "none")
    return Path(cfg.path).expanduser()
