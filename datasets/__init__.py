"""Scenes: one reader per layout on disk, each returning the same `Scene`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from datasets.scene import Scene, SceneError, View, validate_scene

if TYPE_CHECKING:  # the readers know nothing of configs; only this dispatch does
    from pipeline.config import SceneConfig

__all__ = ["Scene", "SceneError", "View", "load_scene", "validate_scene"]


def load_scene(cfg: SceneConfig) -> Scene:
    """The scene a config names; a synthetic one is made first unless it stands in the cache.

    A reader's module is imported only when a config asks for it. Raises SceneError for bad data.
    """
    path = cfg.path
    if cfg.reader == "synthetic":
        from datasets.synthetic import make_scene
        path = make_scene(cfg.name.rpartition("/")[2], cfg.cache, seed=cfg.seed, size=cfg.size,
                          train_views=cfg.train_views, test_views=cfg.test_views)
    elif cfg.reader != "dnerf":
        raise SceneError("scene.reader", "dnerf or synthetic", repr(cfg.reader))
    if path is None:
        raise SceneError("scene.path", "the folder of the data (scene.path=DIR)", "none")

    from datasets.dnerf import read_dnerf
    return read_dnerf(path, name=cfg.name, test_split=cfg.test_split, downscale=cfg.downscale,
                      background=tuple(cfg.background), init_box=tuple(cfg.init_box))
