"""The live view of a run that another process trains: its folder's newest checkpoint and log."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

from pipeline.data.prepare import prepare
from pipeline.model.model import Model
from pipeline.model.ply import load_ply
from pipeline.model.scene_settings import resolved
from pipeline.trained.open_run import stored_config
from pipeline.training import checkpoint as checkpoints
from pipeline.view.live.address import Address
from pipeline.view.live.feed import Feed
from pipeline.view.live.log_tail import LogTail
from pipeline.view.live.server import LiveServer
from pipeline.view.live.training_view import COMPRESSION
from pipeline.view.pack import pack
from pipeline.view.viewer import live_page

POLL_S = 1.0


def serve_run(folder: Path, address: Address, log: Callable[[str], None], stop: threading.Event | None = None) -> None:
    """Serves until Ctrl-C, or until `stop` is set. ValueError, one line, where `folder` is no run."""
    if not (folder / "config.yaml").exists():
        raise ValueError(f"{folder}: expected a run with config.yaml, found none")
    cfg = stored_config(folder)
    scene = prepare(cfg, log).scene
    cfg = resolved(cfg, scene)
    feed, stop = Feed(), stop or threading.Event()
    progress = LogTail(folder / "log.jsonl", cfg.train.iterations)
    packed: tuple[Path, int] | None = None
    with LiveServer(address, live_page(cfg.ablation.name, scene, cfg), feed) as server:
        log(f"live view: {server.url}   (Ctrl-C ends it)")
        try:
            wait = 0.0
            while not stop.wait(wait):
                wait = POLL_S
                if newest := progress.newest():
                    feed.report(newest)
                found = _newest_model(folder)
                if found is not None and found != packed:
                    model, iteration = _load(found[0])
                    feed.offer(iteration, pack(model, scene, COMPRESSION))
                    packed = found
        except KeyboardInterrupt:
            log("live view: ended")


def _newest_model(folder: Path) -> tuple[Path, int] | None:
    """The file with the newest model, and when it was written."""
    for name in (checkpoints.FILE_NAME, "init.ply"):
        path = folder / name
        if path.exists():
            return path, path.stat().st_mtime_ns
    return None


def _load(path: Path) -> tuple[Model, int]:
    """The model and its iteration."""
    if path.name == checkpoints.FILE_NAME:
        return checkpoints.load_model(path), checkpoints.saved_iteration(path)
    return load_ply(path), 0
