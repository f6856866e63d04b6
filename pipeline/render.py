"""Renders a run along a path of cameras: colour, depth and optical flow, as films and as pictures.

--path orbit is an ellipse among the training cameras, once round while time runs; a FILE has poses of its own, and
their times (datasets/cameras/pose_file.py; a data set's transforms_test.json is one). --times 0.5 stops time,
--times 0:1 lets it run, --times 0,0.2,0.4 are the frames' own: seconds since the start, of photographs 0 to 1. Depth is
yellow near and blue far, flow coloured by direction, white at rest.
"""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from datasets.cameras.pose_file import read_poses
from datasets.canonical import Canonical
from pipeline.evaluation.pictures.camera_path import FRAME_RATE, PathFrame
from pipeline.evaluation.pictures.false_colour import depth_picture, depth_range, flow_picture
from pipeline.evaluation.pictures.films import path_of, video
from pipeline.evaluation.pictures.view_pictures import longest_flow, save_picture
from pipeline.evaluation.renderer import Renderer
from pipeline.terminal.command_line import CommandParser, command, log
from pipeline.trained.open_run import open_run
from rasterizer import engine_for
from rasterizer.cores import thread_count

ORBIT = "orbit"
FRAMES = 150  # of an orbit
RANGE_SAMPLES = 8  # frames that determine the colours of depth and flow
PICTURES = 24  # a path of at most so many frames is written as pictures


@command
def main(arguments: list[str]) -> int:
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.frames is not None:
        parser.require(options.path == ORBIT, "--frames", f"--path {ORBIT}", f"--path {options.path}")
        parser.require(options.frames >= 1, "--frames", "at least 1", options.frames)
    run = open_run(options.run, log, needs_images=False)
    renderer = Renderer(run.model, run.scene, run.cfg, engine_for(run.cfg.backend, thread_count(run.cfg.threads)))
    frames = path_frames(renderer, run.canonical, options.path, options.times, options.frames)
    out = options.out or options.run / "films" / (ORBIT if options.path == ORBIT else Path(options.path).stem)
    pictures = options.png or len(frames) <= PICTURES
    written = render_path(renderer, frames, out, films=len(frames) > 1, pictures=pictures)
    log(f"{len(frames)} frames; written to {out}: {', '.join(written)}")
    return 0


def path_frames(
    renderer: Renderer, canonical: Canonical, path: str, times: Times | None, count: int | None
) -> list[PathFrame]:
    """Cameras and times, canonical. ValueError, one line, for times that do not fit."""
    scene = renderer.scene
    ellipse, intrinsics = path_of(renderer)
    if path == ORBIT:
        n = count or (len(times.values) if times and times.listed else FRAMES)
        cameras = [replace(intrinsics, world_to_cam=ellipse.pose(2 * np.pi * i / n)) for i in range(n)]
        own: list[float | None] = [None] * n
    else:
        poses = read_poses(Path(path), canonical.inverse.camera(intrinsics))
        cameras = [canonical.camera(camera) for camera, _ in poses]
        own = [None if time is None else canonical.time(time) for _, time in poses]
    if times is None and None not in own:
        return [PathFrame(camera, time) for camera, time in zip(cameras, own) if time is not None]
    if times is None and any(time is not None for time in own):
        where = f"frames[{own.index(None)}]"
        raise ValueError(f"{path}: expected a time in every frame or in none, found none in {where}; or give --times")
    times = times or Times((0.0, scene.seconds_at(scene.time_end)), listed=False)
    return [PathFrame(camera, scene.time_at(second)) for camera, second in zip(cameras, times.of(len(cameras)))]


@dataclass(frozen=True)
class Times:
    """One value: time stands still. Two that are not listed: from one to the other. Listed ones: one a frame."""

    values: tuple[float, ...]
    listed: bool

    @classmethod
    def parse(cls, text: str) -> Times:
        try:
            values = tuple(float(part) for part in text.replace(":", ",").split(","))
        except ValueError:
            values = ()
        if not values or (":" in text and len(values) != 2) or not np.isfinite(values).all():
            raise argparse.ArgumentTypeError(f"expected times such as 0.5, 0:1 or 0,0.5,1, found {text}")
        return cls(values, listed="," in text)

    def of(self, frames: int) -> list[float]:
        if not self.listed:
            return np.linspace(self.values[0], self.values[-1], frames).tolist()
        if len(self.values) != frames:
            raise ValueError(f"--times: expected {frames}, one a frame of the path, found {len(self.values)}")
        return list(self.values)


def render_path(
    renderer: Renderer, frames: list[PathFrame], out: Path, films: bool = True, pictures: bool = False
) -> list[str]:
    """Writes render.mp4, depth.mp4 and flow.mp4, or 0000_render.png … each, or both; returns their names."""
    out.mkdir(parents=True, exist_ok=True)
    for kind in ("render", "depth", "flow"):
        for old in out.glob(f"[0-9][0-9][0-9][0-9]_{kind}.png"):  # of a longer path
            old.unlink()
    step = renderer.scene.frame_spacing
    moves = renderer.model.kind.motion != "static"
    sampled = [
        renderer.geometry(frame.camera, frame.time, step if moves else None)
        for frame in frames[:: -(-len(frames) // RANGE_SAMPLES)]
    ]
    near, far = depth_range(np.concatenate([geometry.depth.ravel() for geometry in sampled]))
    flows = [geometry.flow for geometry in sampled if geometry.flow is not None]
    longest = max((longest_flow(flow, np.ones(flow.shape[1:], bool)) for flow in flows), default=0.0)
    kinds = ("render", "depth", "flow") if moves else ("render", "depth")
    same_size = len({(frame.camera.width, frame.camera.height) for frame in frames}) == 1
    with ExitStack() as stack:
        size = frames[0].camera.width, frames[0].camera.height
        rate = renderer.scene.playback_rate or FRAME_RATE
        open_films = films and same_size
        senders = [stack.enter_context(video(out / f"{kind}.mp4", *size, rate)) for kind in kinds if open_films]
        for number, frame in enumerate(frames):
            geometry = renderer.geometry(frame.camera, frame.time, step if moves else None)
            images = [renderer.image(frame.camera, frame.time), depth_picture(geometry.depth, near, far)]
            if geometry.flow is not None:
                images.append(flow_picture(geometry.flow, longest))
            for send, image in zip(senders, images):
                send(image)
            for kind, image in zip(kinds, images):
                if pictures or not same_size:
                    save_picture(out / f"{number:04d}_{kind}.png", [image])
    written = [f"{kind}.mp4" for kind in kinds if open_films]
    return written + [f"0000_{kind}.png …" for kind in kinds if pictures or not same_size]


def _parser() -> CommandParser:
    parser = CommandParser("render", __doc__)
    parser.add_argument("run", type=Path, metavar="RUN", help="folder of a finished run")
    parser.add_argument("--path", default=ORBIT, metavar="orbit|FILE", help="of the camera (default: %(default)s)")
    parser.add_argument("--times", type=Times.parse, metavar="T | T0:T1 | T,T,…", help="default: all of the scene's")
    parser.add_argument("--frames", type=int, metavar="N", help=f"of an orbit (default: {FRAMES})")
    parser.add_argument("--png", action="store_true", help=f"pictures too, of more than {PICTURES} frames")
    parser.add_argument("--out", type=Path, metavar="DIR", help="default: RUN/films/PATH")
    return parser


if __name__ == "__main__":
    sys.exit(main())
