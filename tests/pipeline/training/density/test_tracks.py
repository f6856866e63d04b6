"""Tracks of objects that fly, and Gaussians that are linked to them."""

from __future__ import annotations

import numpy as np
import pytest
import tiny
import torch
from test_loop import assert_same_state, interrupted_in
from tiny import TinyRun, random_model, tiny_config, tiny_scene, train_tiny

from pipeline.model.model import Model, ModelKind
from pipeline.training.density.track_linking import brief_particles, link
from pipeline.training.density.tracks import Bandwidths, Particles, find_tracks

TIMES = np.linspace(0, 1, 61)
BANDWIDTHS = Bandwidths(0.12, 2.0)
RADIUS = 0.05  # standard deviation of the particles about their object


def flights(time: np.ndarray) -> np.ndarray:
    """(2, n, 3) two parabolas in opposite directions that meet in the middle."""
    height = 4 * time * (1 - time)
    return np.stack([np.stack([sign * (4 * time - 2), 0.1 * time, height], 1) for sign in (1, -1)])


def swarm(each: int = 600, stray: int = 200) -> tuple[Particles, np.ndarray]:
    """Particles of both objects, then strays of random paths; and the object of each, -1 of strays."""
    rng = np.random.default_rng(0)
    time = rng.uniform(0, 1, 2 * each + stray)
    of = np.repeat([0, 1, -1], [each, each, stray])
    position, velocity = rng.uniform(-1, 1, (len(time), 3)), rng.normal(0, 4, (len(time), 3))
    step = 1e-5
    for number in (0, 1):
        mine = of == number
        here, later = flights(time[mine])[number], flights(time[mine] + step)[number]
        position[mine] = here + rng.normal(0, RADIUS, here.shape)
        velocity[mine] = (later - here) / step + rng.normal(0, 0.5, here.shape)
    return Particles(position, time, velocity, np.full(len(time), 0.02), np.ones(len(time))), of


def test_tracks_are_the_paths_of_what_flies() -> None:
    """Two tracks, each of one object and through all times but its ends. About 25 particles are alive at a moment,
    within 0.05 of it, and strays are as near: a mean is off by 0.01, on an arc within a moment by as much."""
    particles, of = swarm()
    tracks = find_tracks(particles, TIMES, BANDWIDTHS, most=8)
    flown = [np.bincount(of[track.members] + 1, minlength=3) for track in tracks[:2]]
    assert sorted(int(np.argmax(counts)) for counts in flown) == [1, 2]
    for track, counts in zip(tracks, flown):
        assert counts.max() > 0.9 * 600 and counts.sum() - counts.max() < 0.15 * 600  # of the other where they meet
        truth = flights(TIMES[track.moments])[int(np.argmax(counts)) - 1]
        error = np.linalg.norm(track.center - truth, axis=1)
        assert len(track.moments) > 55 and error.mean() < 0.03
    members = np.concatenate([track.members for track in tracks])
    assert len(np.unique(members)) == len(members), "a particle is of one track"


def test_a_track_ends_where_its_object_does() -> None:
    particles, of = swarm(stray=0)
    early = (of == 0) & (particles.time < 0.5)
    part = Particles(*(getattr(particles, name)[early] for name in Particles.__dataclass_fields__))
    (track,) = find_tracks(part, TIMES, BANDWIDTHS, most=8)
    assert TIMES[track.moments[0]] < 0.05 and 0.45 < TIMES[track.moments[-1]] < 0.56


def test_strays_have_no_tracks() -> None:
    particles, of = swarm()
    strays = Particles(*(getattr(particles, name)[of == -1] for name in Particles.__dataclass_fields__))
    assert find_tracks(strays, TIMES, BANDWIDTHS, most=8) == []


def flying_model() -> Model:
    """Brief Gaussians of both objects, and long-lived ones at rest."""
    particles, of = swarm(300, 100)
    model = random_model(ModelKind("velocity", 2, 3), len(of))
    rest = torch.from_numpy(of == -1)
    model.parameters |= {
        "mean": torch.from_numpy(np.c_[particles.position, particles.time]).float(),
        "velocity": torch.from_numpy(np.where(of[:, None] == -1, 0, particles.velocity)).float(),
        "opacity_logit": torch.full((len(of),), 2.0),
        "log_scale": torch.full((len(of), 4), np.log(0.02)),
    }
    model.parameters["log_scale"][rest, 3] = np.log(2.0)
    return model


def test_linked_gaussians_stay_where_they_were_at_their_own_times() -> None:
    """Position and velocity on the spline, in float64, are those before. Tolerance: float32 of values up to 10."""
    model = flying_model()
    rows, particles, bandwidths = brief_particles(model, 1.0)
    tracks = find_tracks(particles, TIMES, bandwidths, most=8)
    linked, count = link(model, rows, particles, TIMES, tracks)
    weights = linked.parameters["weights"]
    assert count >= 2 and linked.kind.trajectories == count and linked.trajectories is not None
    assert not weights[600:].any(), "what rests follows no track"
    assert weights[:600].any(dim=1).float().mean() > 0.85
    slower = []
    for row in weights.any(dim=1).nonzero()[:, 0].tolist():
        time, weight = float(model.parameters["mean"][row, 3]), weights[row].double()
        values = linked.trajectories.values(time).double()[:, :3], linked.trajectories.drift(time, 0).double()
        displaced, drift = (weight @ value for value in values)
        mean, velocity = (linked.parameters[name][row].double() for name in ("mean", "velocity"))
        torch.testing.assert_close(mean[:3] + displaced, model.parameters["mean"][row, :3].double(), atol=2e-6, rtol=0)
        torch.testing.assert_close(velocity + drift, model.parameters["velocity"][row].double(), atol=2e-5, rtol=0)
        slower.append(velocity.norm() < model.parameters["velocity"][row].norm())
    assert np.mean(slower) > 0.9, "the track explains most of their velocity"


def test_what_does_not_move_is_not_linked(tmp_path) -> None:
    """An initial model at rest: the run goes on without trajectories."""
    model = train_tiny(tmp_path, tiny_config(20, motion="tracks")).model
    assert model.trajectories is None
    assert [row["tracks"] for row in TinyRun(tmp_path).rows("log.jsonl") if "tracks" in row] == [0]


def test_training_goes_on_with_tracks_and_resumes_to_the_bit(tmp_path) -> None:
    """Interrupted after the linking of iteration 12 of 30; membership does not change, the paths do."""
    scene, cfg = tiny_scene(61), tiny_config(30, motion="tracks")
    with pytest.MonkeyPatch.context() as given, pytest.MonkeyPatch.context() as dying:
        given.setattr(tiny, "initialise", lambda *rest: flying_model())
        given.setattr(tiny, "tiny_scene", lambda: scene)
        model = train_tiny(tmp_path / "whole", cfg).model
        interrupted_in(22, tmp_path / "parts", dying, cfg)
        train_tiny(tmp_path / "parts", cfg)
    assert_same_state(tmp_path / "whole", tmp_path / "parts")
    assert model.trajectories is not None and model.trajectories.control_points.any()
    assert set(model.parameters["weights"].unique().tolist()) == {0.0, 1.0}
