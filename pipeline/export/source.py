"""What is exported: the model of a run folder or of a file, and the time of its scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from datasets.canonical import Canonical
from pipeline.model.model import Model
from pipeline.model.ply import stated_coordinates
from pipeline.model.transformed import in_canonical
from pipeline.trained.open_run import open_run, read_model
from rasterizer import Camera

PLAYED_SECONDS = 5.0  # of photographs, which have no frame rate
FRAMES = 300  # of a file's timeline, whose frames are not known


@dataclass(frozen=True)
class Timeline:
    """The time of a scene, in its own unit, and how it is played."""

    start: float
    duration: float
    seconds: float = PLAYED_SECONDS  # of playback
    frames: int = FRAMES  # Scene.frame_count; for a player's slider
    clock: float | None = None  # seconds per unit of time, of a run; None: of a file, whose times are its own
    camera: Camera | None = None  # that a player begins with; None: one that has the Gaussians before it

    @property
    def end(self) -> float:
        return self.start + self.duration

    def at(self, given: float) -> float:
        """The time of a value of --times: seconds since the start of a run, or a file's own time. ValueError outside.

        A hundredth of a second beyond the end is rounding of what viewer and tables show.
        """
        rounding = 0.0 if self.clock is None else 0.01
        low, high = (self.start, self.end) if self.clock is None else (0.0, self.duration * self.clock)
        if not low <= given <= high + rounding:
            raise ValueError(f"--times: expected times in {low:g} to {high:g}, found {given:g}")
        return given if self.clock is None else self.start + min(given, high) / self.clock


@dataclass(frozen=True)
class Source:
    """A model and its time, both canonical."""

    model: Model
    timeline: Timeline
    canonical: Canonical  # from the coordinates of the data's files; of a file that does not state it: the identity
    name: str  # of the exported files
    folder: Path  # where they are written by default
    file: Path | None = None  # that the model was read from, which is not overwritten; None: of a run
    known: bool = True  # whether `canonical` is

    def in_file(self, data_to_file: Canonical) -> tuple[Model, Timeline]:
        """Both in the coordinates of a file."""
        if data_to_file == self.canonical:
            return self.model, self.timeline
        line, change = self.timeline, self.canonical.inverse.then(data_to_file)
        camera = None if line.camera is None else change.camera(line.camera)
        start, duration = change.time(line.start), line.duration * change.time_scale
        return in_canonical(self.model, change), replace(line, start=start, duration=duration, camera=camera)


def open_source(path: Path, start: float | None, duration: float | None, log: Callable[[str], None]) -> Source:
    """A run folder, which has its times; or a file, whose times are `start` (0) to start + `duration` (1).

    ValueError, one line, for anything else and for options that do not fit.
    """
    if path.is_file():
        model = read_model(path, Canonical())
        timeline = Timeline(start or 0.0, 1.0 if duration is None else duration)
        stated = stated_coordinates(path) if path.suffix == ".ply" else None
        known = stated is not None or path.suffix == ".pth"
        name = path.name.removesuffix(path.suffix)
        return Source(model, timeline, stated or Canonical(), name, path.parent / "exports", path, known)
    if start is not None or duration is not None:
        raise ValueError(f"{path}: expected a file with --start or --duration, found none; a run has its times")
    run = open_run(path, log, needs_images=False)
    scene = run.scene
    seconds, camera = scene.played_seconds or PLAYED_SECONDS, scene.train[0].camera
    timeline = Timeline(scene.time_start, scene.duration, seconds, scene.frame_count, scene.clock, camera)
    return Source(run.model, timeline, run.canonical, run.cfg.scene.name.replace("/", "_"), path / "exports")
