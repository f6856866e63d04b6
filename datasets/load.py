"""Loads the scene of a configuration, by its kind (kinds.py) and reader.

Readers are imported where they are called: most scenes need no video decoder.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from datasets.composition import BLACK, WHITE, Color, as_color
from datasets.files.errors import SceneError
from datasets.kinds import data_path, scene_kind, synthetic_name, with_reader
from datasets.scene import PLAYBACK_RATE, Scene, validate_scene
from datasets.settings import LAYOUTS, SceneConfig
from datasets.validation import hold_out_every, hold_out_outermost

if TYPE_CHECKING:
    from datasets.clip import Clip, ClipOptions, ClipSet
    from datasets.plenoptic import Footage, PosedFootage

Log = Callable[[str], None]  # called with a line of text for the user


def load_scene(cfg: SceneConfig, *, threads: int = 0, log: Log = print) -> Scene:
    """The scene of data with known poses. Synthetic scenes are made and videos are decoded first, unless they are in
    the cache.

    threads: for decoding; 0: all cores. Raises SceneError for invalid data, and for videos whose cameras are known only
    after structure from motion.
    """
    cfg = with_reader(cfg)
    kind = scene_kind(cfg)
    if kind == "drive":
        return _load_drive(cfg, log)
    if kind != "photographs":
        return load_posed(cfg, threads=threads, log=log).to_scene()
    scene = _load_photographs(cfg, log)
    if not cfg.validation_every:
        return scene
    hold_out = hold_out_outermost if cfg.validation_outermost else hold_out_every
    return validate_scene(hold_out(scene, cfg.validation_every))


def load_posed(cfg: SceneConfig, *, threads: int = 0, log: Log = print) -> PosedFootage:
    """Videos of several cameras with known poses, checked but not decoded; PosedFootage.to_scene decodes them."""
    if scene_kind(cfg) != "posed_videos":
        raise SceneError(
            "scene.reader",
            "several cameras with known poses: plenoptic, or a synthetic scene of that kind",
            repr(cfg.reader),
        )
    from datasets.plenoptic import open_plenoptic

    options = _footage_options(cfg, threads, log)
    path = _make_synthetic(cfg, log) if cfg.reader == "synthetic" else data_path(cfg)
    return open_plenoptic(path, **options)


def load_footage(cfg: SceneConfig, *, threads: int = 0, log: Log = print) -> Footage:
    """Videos of several cameras that stand still, checked but not decoded: enough to estimate the cost of a run.

    Without poses Footage.to_scene takes those of structure from motion.
    """
    cfg = with_reader(cfg)
    if cfg.reader == "video":
        from datasets.plenoptic import read_footage

        return read_footage(data_path(cfg), **_footage_options(cfg, threads, log))
    return load_posed(cfg, threads=threads, log=log).footage


def load_clip(cfg: SceneConfig, log: Log = print) -> Clip:
    """The video of one camera that moves: its frames in use, without poses."""
    from datasets.clip import open_clip

    _refuse_validation(cfg, "clips (scene.test_every holds out other frames)")
    return open_clip(data_path(cfg), _clip_options(cfg, log))


def load_clip_set(cfg: SceneConfig, log: Log = print) -> ClipSet:
    """The videos of several cameras of which some move: their frames in use, without poses."""
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
    return open_clip_set(data_path(cfg), options, settings)


def background_color(setting: str | Sequence[float]) -> Color | None:
    """scene.background as RGB in [0, 1]; None for auto."""
    if isinstance(setting, str):
        return {"auto": None, "black": BLACK, "white": WHITE}[setting]
    return as_color(setting)


def _load_photographs(cfg: SceneConfig, log: Log) -> Scene:
    """Calls the reader of cfg.reader. A new reader gets its branch here."""
    if cfg.reader in LAYOUTS:
        from datasets.layouts import LayoutOptions, read_layout

        options = LayoutOptions(
            cfg.name,
            cfg.downscale,
            cfg.test_every,
            cfg.test_cameras,
            cfg.drop_cameras,
            cfg.first_frame,
            cfg.frames,
            background_color(cfg.background),
            log,
        )
        return read_layout(cfg.reader, data_path(cfg), options)
    from datasets.dnerf import has_split, read_dnerf

    path = _make_synthetic(cfg, log) if cfg.reader == "synthetic" else data_path(cfg)
    # With a validation split a scene needs no test split.
    split = None if cfg.validation_every and not has_split(path, cfg.test_split) else cfg.test_split
    scene = read_dnerf(
        path,
        name=cfg.name,
        test_split=split,
        downscale=cfg.downscale,
        background=background_color(cfg.background),
        init_box=(cfg.init_box[0], cfg.init_box[1]),
        log=log,
    )
    filmed = cfg.reader == "synthetic" and cfg.camera_path == "arc" and scene.capture == "monocular"
    return replace(scene, capture="clip", playback_rate=PLAYBACK_RATE) if filmed else scene


def _load_drive(cfg: SceneConfig, log: Log) -> Scene:
    from datasets.urban import open_log
    from datasets.urban.assemble import scene_of_log

    if cfg.reader == "synthetic":
        return scene_of_log(open_log("waymo", _make_synthetic(cfg, log)), cfg, log)
    return scene_of_log(open_log(cfg.reader, data_path(cfg)), cfg, log)


def _make_synthetic(cfg: SceneConfig, log: Log) -> Path:
    """The folder of a synthetic scene, which is rendered first unless it is in the cache."""
    from datasets.synthetic import make_scene

    what = "frames" if scene_kind(cfg) == "drive" else "cameras"
    return make_scene(
        synthetic_name(cfg),
        cfg.cache,
        seed=cfg.seed,
        size=cfg.size,
        train_views=cfg.train_views,
        test_views=cfg.test_views,
        cameras=cfg.cameras,
        frames=cfg.frames,
        layout=cfg.layout,
        camera_path=cfg.camera_path,
        progress=lambda done, total: log(f"{cfg.name}: {done} of {total} {what} rendered"),
    )


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


def _refuse_validation(cfg: SceneConfig, footage: str) -> None:
    """SceneError for scene.validation_every, which is for photographs with poses."""
    if cfg.validation_every:
        raise SceneError("scene.validation_every", f"0 for {footage}", str(cfg.validation_every))
