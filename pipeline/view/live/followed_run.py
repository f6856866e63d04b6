"""The live view of a run that another process trains: its folder's newest checkpoint and log."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from pathlib import Path

from pipeline.data.prepare import prepare
from pipeline.model.model import Model
from pipeline.model.ply import load_ply
from pipeline.trained.open_run import stored_config
from pipeline.training import checkpoint as checkpoints
from pipeline.view.live.feed import COMPRESSION, Feed
from pipeline.view.live.server import Address, LiveServer
from pipeline.view.pack import pack
from pipeline.view.viewer import live_page

POLL_S = 1.0


def serve_run(folder: Path, address: Address, log: Callable[[str], None], stop: threading.Event | None = None) -> None:
    """Serves until Ctrl-C, or until `stop` is set. ValueError, one line, where `folder` is no run."""
    if not (folder / "config.yaml").exists():
        raise ValueError(f"{folder}: expected a run with config.yaml, found none")
    cfg = stored_config(folder)
    scene = prepare(cfg, log).scene
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
    if path.name == checkpoints.FILE_NAME:
        return checkpoints.load_model(path), checkpoints.saved_iteration(path)
    return load_ply(path), 0


class LogTail:
    """The newest numbers in a log.jsonl that grows; reads only what was added since the last time."""

    def __init__(self, path: Path, iterations: int) -> None:
        self._path, self._iterations = path, iterations
        self._place = 0
        self._held_out: float | None = None

    def newest(self) -> dict | None:
        """The numbers of the newest iteration, as TrainingView.step reports them; None without a newer one."""
        if not self._path.exists():
            return None
        with open(self._path, "rb") as file:
            file.seek(0, 2)
            if file.tell() < self._place:  # the run was started anew
                self._place = 0
            file.seek(self._place)
            text = file.read()
        whole = text[: text.rfind(b"\n") + 1]
        self._place += len(whole)
        found = None
        for line in whole.splitlines():
            try:
                row = json.loads(line)
                if row["event"] == "evaluate":
                    self._held_out = row["psnr"]
                elif row["event"] == "train":
                    found = {name: row[name] for name in ("iteration", "loss", "psnr", "n_gaussians")}
            except (ValueError, KeyError, TypeError):
                continue
        return found and {**found, "iterations": self._iterations, "held_out": self._held_out}
