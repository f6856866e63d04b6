"""Linking: brief Gaussians that follow one another along a track share its path.

A brief Gaussian is seen by the few images of its moment, which determine its velocity badly. Its track, through all of
them, is seen by many. Each member of a track gets a weight of 1 for the track's trajectory, and its own velocity
becomes that relative to it; at its own time it stays where it was. The paths are trained from there. Gaussians of no
track have no weights.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.model.model import CPU, Model
from pipeline.training.density.tracks import Bandwidths, Particles, Track, find_tracks
from pipeline.training.schedule import Passing, Phase
from pipeline.training.state import TrainState
from rasterizer.trajectories import MAX_INTERVALS, Trajectories, level_intervals

START = 0.4  # of the iterations
MOST_TRACKS = 32
BRIEF, OPAQUE = 0.15, 0.05  # largest st, × duration, and least opacity of Gaussians that form tracks
TIMES_PER_INTERVAL = 3  # training times for each interval of the finest splines
SMOOTHNESS = 1e-3  # weight of the squared control points, × the number of a level's intervals squared
DISTANCE, SPEED = 0.08, 0.6  # bandwidths, × the diagonal of the brief Gaussians' box and × their median speed
FASTEST_REST = 2.0  # × the bandwidth: Gaussians that would move less in the whole duration form no tracks
UNEXPLAINED = 0.7  # a track's members have at most this share of their squared velocities relative to it


class TrackLinking:
    """Once, after START of the schedule."""

    event = "link_tracks"

    def __init__(self, scene: Scene, cfg: Config) -> None:
        self._scene = scene
        self._start = Passing(round(START * cfg.train.iterations))

    def due(self, iteration: int, clock: float) -> bool:
        return self._start.now(iteration, clock)

    def apply(self, state: TrainState, phase: Phase) -> dict[str, int]:
        device, model = state.model.device, state.model.to(CPU)
        times = np.array(sorted({view.time for view in self._scene.train}))
        if model.kind.motion != "velocity" or model.kind.trajectories or len(times) < 2:
            return {"tracks": 0, "linked": 0}
        rows, particles, bandwidths = brief_particles(model, self._scene.duration)
        tracks = find_tracks(particles, times, bandwidths, MOST_TRACKS) if len(rows) else []
        linked, explained = link(model, rows, particles, times, tracks)
        if explained:
            state.model = linked.to(device)
            state.optimiser.adopt(state.model)
            state.reset_gradients()
        return {"tracks": explained, "linked": int(linked.parameters["weights"].any(dim=1).sum()) if explained else 0}


def brief_particles(model: Model, duration: float) -> tuple[np.ndarray, Particles, Bandwidths]:
    """Rows (n,) of the Gaussians that may form tracks, these as particles, and the bandwidths. n = 0: none move."""
    values = {name: model.parameters[name].double().numpy() for name in ("mean", "velocity", "log_scale")}
    opacity = torch.sigmoid(model.parameters["opacity_logit"]).double().numpy()
    lifetime, speed = np.exp(values["log_scale"][:, 3]), np.linalg.norm(values["velocity"], axis=1)
    brief = (lifetime < BRIEF * duration) & (opacity > OPAQUE)
    low, high = np.quantile(values["mean"][brief, :3], (0.05, 0.95), axis=0) if brief.any() else (np.zeros(3),) * 2
    distance = DISTANCE * float(np.linalg.norm(high - low))
    rows = np.flatnonzero(brief & (speed * duration > FASTEST_REST * distance))
    particles = Particles(
        values["mean"][rows, :3], values["mean"][rows, 3], values["velocity"][rows], lifetime[rows], opacity[rows]
    )
    return rows, particles, Bandwidths(distance, SPEED * float(np.median(speed[rows])) if len(rows) else 1.0)


def link(
    model: Model, rows: np.ndarray, particles: Particles, times: np.ndarray, tracks: list[Track]
) -> tuple[Model, int]:
    """The model whose Gaussians follow the tracks that explain their velocities, and how many these are."""
    intervals = min(max(round(len(times) / TIMES_PER_INTERVAL), 2), MAX_INTERVALS)
    still = Trajectories.still(1, intervals, (float(times[0]), float(times[-1])))
    at_times = np.stack([still.basis(float(time)).numpy() for time in times])
    kept: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]] = []  # control points, rows, displaced, velocity
    for track in tracks:
        of = track.members
        points = fitted(at_times[track.moments], track, intervals)
        own = [float(time) for time in particles.time[of]]
        displaced = np.stack([still.basis(time).numpy() for time in own]) @ points
        relative = particles.velocity[of] - np.stack([still.drift_basis(time, 0).numpy() for time in own]) @ points
        if (relative**2).sum() < UNEXPLAINED * (particles.velocity[of] ** 2).sum():
            kept.append((points, rows[of], displaced, relative))
    if not kept:
        return model, 0
    control_points = torch.zeros(len(still.control_points), len(kept), 6)
    weights = torch.zeros(len(model), len(kept))
    parameters = {**model.parameters, **{name: model.parameters[name].clone() for name in ("mean", "velocity")}}
    for number, (points, members, displaced, relative) in enumerate(kept):
        control_points[:, number, :3] = torch.from_numpy(points)
        weights[members, number] = 1.0
        parameters["mean"][members, :3] -= torch.from_numpy(displaced).float()
        parameters["velocity"][members] = torch.from_numpy(relative).float()
    kind = replace(model.kind, trajectories=len(kept))
    shared = Trajectories(control_points, still.span)
    return Model(kind, {**parameters, "weights": weights}, model.sphere, model.environment_map, shared), len(kept)


def fitted(basis: np.ndarray, track: Track, intervals: int) -> np.ndarray:
    """(C, 3) control points of the smooth spline through the centers, relative to their mean. basis: (m, C)."""
    levels = np.concatenate([np.full(n + 3, n) for n in level_intervals(intervals)])
    weight = (track.support / track.support.max())[:, None]
    normal = basis.T @ (weight * basis) + np.diag(SMOOTHNESS * (0.5 * levels) ** 2)
    return np.linalg.solve(normal, basis.T @ (weight * (track.center - track.center.mean(axis=0))))
