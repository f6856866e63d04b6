"""Scenes: one reader per layout on disk, each returning the same `Scene`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from datasets.composition import BLACK, WHITE, Color
from datasets.scene import Scene, SceneError, View, validate_scene
from datasets.settings import SceneConfig
from datasets.validation import hold_out_every, hold_out_outermost

if TYPE_CHECKING:  # it brings a video decoder, which other scenes do without
    from datasets.plenoptic import Footage, Posed

__all__ = [
    "Footage",
    "Scene",
    "SceneError",
    "View",
    "is_filmed",
    "load_footage",
    "load_posed",
    "load_scene",
    "validate_scene",
]

Log = Callable[[str], None]  # takes a line of text for the user


def load_scene(cfg: SceneConfig, *, threads: int = 0, log: Log = print) -> Scene:
    """The scene a config names; a synthetic one is made first, videos are decoded first, unless the cache holds them.

    threads: that decode; 0 for all. A reader's module is imported only when a config asks for it. Raises SceneError
    for bad data, and for the reader `video`: its cameras are known only after structure from motion, see load_footage.
    """
    if is_filmed(cfg):
        return load_posed(cfg, threads=threads, log=log).to_scene()
    if cfg.reader not in ("dnerf", "synthetic"):
        raise SceneError("scene.reader", "dnerf, plenoptic or synthetic", repr(cfg.reader))
    from datasets.dnerf import has_split, read_dnerf

    path = _make_synthetic(cfg, log) if cfg.reader == "synthetic" else _path(cfg)
    # Where training views are held out, a scene may come without a test split.
    split = None if cfg.validation_every and not has_split(path, cfg.test_split) else cfg.test_split
    scene = read_dnerf(
        path,
        name=cfg.name,
        test_split=split,
        downscale=cfg.downscale,
        background=background_color(cfg.background),
        init_box=tuple(cfg.init_box),
        log=log,
    )
    if not cfg.validation_every:
        return scene
    hold_out = hold_out_outermost if cfg.validation_outermost else hold_out_every
    return validate_scene(hold_out(scene, cfg.validation_every))


def background_color(asked: str | Sequence[float]) -> Color | None:
    """What scene.background means: RGB in [0, 1]; None for auto."""
    if isinstance(asked, str):
        return {"auto": None, "black": BLACK, "white": WHITE}[asked]
    return tuple(float(channel) for channel in asked)


def load_posed(cfg: SceneConfig, *, threads: int = 0, log: Log = print) -> Posed:
    """What several cameras filmed, and where they stood: checked but not decoded; Posed.to_scene makes the scene."""
    if cfg.reader == "video" or not is_filmed(cfg):
        raise SceneError(
            "scene.reader",
            "several cameras with known poses: plenoptic, or a synthetic scene of that kind",
            repr(cfg.reader),
        )
    from datasets.plenoptic import open_plenoptic

    filming = _filming(cfg, threads, log)
    path = _make_synthetic(cfg, log) if cfg.reader == "synthetic" else _path(cfg)
    return open_plenoptic(path, **filming)


def load_footage(cfg: SceneConfig, *, threads: int = 0, log: Log = print) -> Footage:
    """The videos a config names, checked but not decoded; what a run will cost can be told from them.

    Of the reader `video` this is all there is until cameras are known for it: Footage.to_scene makes the scene.
    """
    if cfg.reader == "video":
        from datasets.plenoptic import read_footage

        return read_footage(_path(cfg), **_filming(cfg, threads, log))
    return load_posed(cfg, threads=threads, log=log).footage


def is_filmed(cfg: SceneConfig) -> bool:
    """Did several cameras film it at once? Then frames are decoded into a store, and points come from COLMAP."""
    if cfg.reader == "synthetic":
        from datasets.synthetic import FILMED

        return _synthetic_name(cfg) in FILMED
    return cfg.reader in ("plenoptic", "video")


def __getattr__(name: str) -> Any:
    if name == "Footage":  # late, as all that needs a video decoder
        from datasets.plenoptic import Footage

        return Footage
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def _make_synthetic(cfg: SceneConfig, log: Log) -> Path:
    from datasets.synthetic import make_scene

    return make_scene(
        _synthetic_name(cfg),
        cfg.cache,
        seed=cfg.seed,
        size=cfg.size,
        train_views=cfg.train_views,
        test_views=cfg.test_views,
        cameras=cfg.cameras,
        frames=cfg.frames,
        progress=lambda done, all_of_them: log(f"{cfg.name}: {done} of {all_of_them} cameras filmed"),
    )


def _synthetic_name(cfg: SceneConfig) -> str:
    return cfg.name.rpartition("/")[2]


def _filming(cfg: SceneConfig, threads: int, log: Log) -> dict[str, Any]:
    """The fields of datasets.plenoptic.Reading. SceneError where views are to be held out, not cameras."""
    if cfg.validation_every:
        raise SceneError(
            "scene.validation_every",
            f"0 for {cfg.name}, which several cameras filmed (hold out another by scene.test_cameras)",
            str(cfg.validation_every),
        )
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
    }


def _path(cfg: SceneConfig) -> Path:
    if cfg.path is None:
        raise SceneError("scene.path", "the folder of the data (scene.path=DIR)", "none")
    return Path(cfg.path).expanduser()
