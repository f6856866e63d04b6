"""Canonical coordinates: the same scene from any unit and origin, and none of what obeys the convention is touched."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tiny import tiny_scene
from tiny_film import RATE, tiny_film

from datasets.canonical import DISTANCE, Canonical, canonical_of, canonical_space, canonicalise
from datasets.dnerf import read_dnerf
from datasets.scene import Scene, View, camera_extent, validate_scene
from datasets.synthetic import PHOTOGRAPHED, build_scene
from pipeline.evaluation.camera_path import look_at
from rasterizer import Camera

DOWN = np.array([0.0, 1.0, 0.0])
SCALES, SHIFTS = (1e3, 1e-3, 0.7, 25.4), ((0.0, 0.0, 0.0), (1e4, -2e4, 5e3))
# float64: a number near 2e4 is good to 4e-12, which is 4e-9 of a rig that is a thousandth of a unit; a pose, its
# inverse and a mean are some ten such roundings.
EXACT = 1e-7


def camera(position: np.ndarray, target: np.ndarray) -> Camera:
    return Camera(64, 48, 60.0, 61.0, 30.0, 25.0, look_at(np.asarray(position, float), np.asarray(target, float), DOWN))


def grid(distance: float = 5.0) -> list[Camera]:
    """5 × 3 cameras on a plane that look at about one point."""
    generator = np.random.default_rng(0)
    return [
        camera((x, y, 2.0), np.array([0.3, -0.2, 2.0 + distance]) + 0.1 * generator.standard_normal(3))
        for x in (-1, -0.5, 0, 0.5, 1)
        for y in (-0.5, 0, 0.5)
    ]


def ring(outwards: bool = False) -> list[Camera]:
    """On a circle of radius 3 about (1, 2, 3), looking at that or away from it."""
    places = [3 * np.array([np.cos(a), 0.1, np.sin(a)]) for a in np.linspace(0, 2 * np.pi, 9)[:-1]]
    return [camera(p + (1, 2, 3), (3 * p if outwards else 0 * p) + (1, 2, 3)) for p in places]


def parallel() -> list[Camera]:
    return [camera((x, 0.1 * x, 1.0), (x, 0.1 * x, 9.0)) for x in (-1.0, 0.0, 0.5, 1.5)]


RIGS = {"grid": grid(), "ring": ring(), "outwards": ring(outwards=True), "parallel": parallel()}


def moved(c: Camera, scale: float, shift: np.ndarray) -> Camera:
    """The camera in a world of which a point x is at scale x + shift."""
    pose = c.world_to_cam.copy()
    pose[:3, 3] = scale * pose[:3, 3] - pose[:3, :3] @ shift
    return replace(c, world_to_cam=pose)


def scene_of(cameras: list[Camera], unit: float = 0.8, **changes: object) -> Scene:
    blank = np.zeros((48, 64, 3), np.uint8)
    views = tuple(View(c, i / (len(cameras) - 1), blank, f"train/r_{i}") for i, c in enumerate(cameras))
    made = Scene(
        "rig",
        views,
        (replace(views[0], name="test/r_0"),),
        1.0,
        0.0,
        (0.0, 0.0, 0.0),
        camera_extent(cameras),
        (-2.0, 3.0),
        Path("rig"),
        unit=unit,
    )
    return replace(made, **changes)


def in_another_world(scene: Scene, scale: float, shift: np.ndarray, clock=lambda t: t) -> Scene:
    """The scene as files in other units would give it."""

    def view_of(view: View) -> View:
        return replace(view, camera=moved(view.camera, scale, shift), time=clock(view.time))

    start, end = clock(scene.time_start), clock(scene.time_end)
    return replace(
        scene,
        train=tuple(map(view_of, scene.train)),
        test=tuple(map(view_of, scene.test)),
        extent=scale * scene.extent,
        unit=scale * scene.unit,
        time_start=start,
        duration=end - start,
        init_box=tuple(tuple(scale * corner + np.asarray(shift)) for corner in scene.init_box),
        frame_rate=scene.frame_rate and scene.frame_rate * scene.duration / (end - start),
    )


def normalised(scene: Scene) -> Scene:
    return canonicalise(scene, canonical_of(scene))


def assert_same(one: Scene, two: Scene, tolerance: float = EXACT) -> None:
    for a, b in zip(one.train + one.test, two.train + two.test, strict=True):
        np.testing.assert_allclose(b.camera.world_to_cam, a.camera.world_to_cam, atol=tolerance)
        assert b.time == pytest.approx(a.time, abs=tolerance) and b.image is a.image and b.name == a.name
        assert all(getattr(a.camera, k) == getattr(b.camera, k) for k in ("width", "height", "fx", "fy", "cx", "cy"))
    for name in ("duration", "time_start", "extent", "unit", "frame_rate"):
        if getattr(one, name) is not None:
            assert getattr(two, name) == pytest.approx(getattr(one, name), abs=tolerance), name
    box_of = [np.stack([np.broadcast_to(corner, 3) for corner in scene.init_box]) for scene in (one, two)]
    np.testing.assert_allclose(*box_of, atol=tolerance)


# --- space ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rig", RIGS)
@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("shift", SHIFTS)
def test_every_unit_and_origin_gives_the_same_scene(rig: str, scale: float, shift: tuple) -> None:
    scene = scene_of(RIGS[rig])
    other = in_another_world(scene, scale, np.array(shift))
    assert not canonical_of(scene).is_identity
    one, two = normalised(scene), normalised(other)
    assert_same(one, two)
    assert validate_scene(two) is two


@pytest.mark.parametrize("rig", RIGS)
def test_the_same_without_a_known_unit(rig: str) -> None:
    """What readers of files without bounds ask: their unit is the canonical one."""
    frame = canonical_space(RIGS[rig])
    for scale in SCALES:
        for shift in SHIFTS:
            other = canonical_space([moved(c, scale, np.array(shift)) for c in RIGS[rig]])
            assert other.unit == pytest.approx(scale * frame.unit, rel=EXACT)
            np.testing.assert_allclose(other.points(scale * np.ones(3) + shift), frame.points(np.ones(3)), atol=EXACT)


@pytest.mark.parametrize(("rig", "centre"), [("grid", None), ("ring", (1, 2, 3))])
def test_cameras_look_at_the_origin_from_four_units_away(rig: str, centre: tuple | None) -> None:
    frame = canonical_space(RIGS[rig], unit=123.0)  # known, but not needed
    cameras = [frame.camera(c) for c in RIGS[rig]]
    assert np.mean([np.linalg.norm(c.position) for c in cameras]) == pytest.approx(DISTANCE)
    # Naively: no point near the origin is nearer to all optical axes.
    positions = np.stack([c.position for c in cameras])
    axes = np.stack([c.world_to_cam[2, :3] for c in cameras])

    def squared(point: np.ndarray) -> float:
        return float(np.sum(np.cross(point - positions, axes) ** 2))

    steps = np.random.default_rng(1).standard_normal((50, 3))
    assert all(squared(np.zeros(3)) < squared(1e-2 * step) for step in steps)
    if centre is not None:
        np.testing.assert_allclose(frame.centre, centre, atol=EXACT)


def test_parallel_axes_look_four_units_ahead() -> None:
    frame = canonical_space(parallel(), unit=0.5)
    assert frame.unit == 0.5
    np.testing.assert_allclose(frame.centre, (0.25, 0.025, 1.0 + 4 * 0.5), atol=EXACT)
    assert canonical_space(parallel()).unit == pytest.approx(camera_extent(parallel()))


def test_cameras_that_look_all_around_stand_round_the_origin() -> None:
    np.testing.assert_allclose(canonical_space(ring(outwards=True), unit=0.5).centre, (1, 2.3, 3), atol=EXACT)


def test_frames_of_one_camera_do_not_pull_the_origin_to_it() -> None:
    once, often = canonical_space(grid()), canonical_space(grid() + 50 * [grid()[0]])
    assert once == often


def test_what_is_seen_stays_where_it_is_in_the_image_and_depths_scale() -> None:
    frame = Canonical((1e4, 20.0, -3.0), 0.25)
    points = np.random.default_rng(2).normal(size=(20, 3)) + frame.centre
    c = moved(grid()[0], 1.0, np.array(frame.centre))
    before = c.world_to_cam[:3, :3] @ points.T + c.world_to_cam[:3, 3:]
    after = frame.camera(c).world_to_cam[:3, :3] @ frame.points(points).T + frame.camera(c).world_to_cam[:3, 3:]
    np.testing.assert_allclose(after, frame.scale * before, atol=EXACT)
    np.testing.assert_allclose(frame.camera(c).position, frame.points(c.position), atol=EXACT)
    np.testing.assert_allclose(frame.inverse.points(frame.points(points)), points, atol=1e-11)
    np.testing.assert_allclose(frame.inverse.camera(frame.camera(c)).world_to_cam, c.world_to_cam, atol=1e-11)


def test_a_cube_comes_back_from_the_world() -> None:
    frame = Canonical((1e4, 20.0, -3.0), 0.25)
    world = frame.inverse.box((-1.2, 1.2))
    np.testing.assert_allclose(world, [(9995.2, 15.2, -7.8), (10004.8, 24.8, 1.8)])
    np.testing.assert_allclose(frame.box(world), [3 * (-1.2,), 3 * (1.2,)], atol=EXACT)
    assert Canonical(time_scale=2.0).box((-1.2, 1.2)) == (-1.2, 1.2)


def test_the_inverse_leads_back() -> None:
    frame = Canonical((1e4, 20.0, -3.0), 0.25, 1.7e9, 0.2)
    assert frame.inverse.time(frame.time(1.7e9 + 3)) == pytest.approx(1.7e9 + 3, abs=1e-6)
    assert Canonical().inverse.is_identity


def test_metres_of_a_map_are_no_reason_to_refuse_a_scene() -> None:
    scene = scene_of(grid())
    far = validate_scene(in_another_world(scene, 1.0, np.array([5e5, 5e6, 100.0])))
    assert_same(normalised(scene), normalised(far), tolerance=1e-6)  # positions of 5e6 are good to 1e-9


# --- time -----------------------------------------------------------------------------------------------------------

CLOCKS = {
    "frames": lambda s: 30 * s,
    "milliseconds": lambda s: 1000 * s,
    "epoch": lambda s: 1.7e9 + s,
    "minutes": lambda s: s / 60 + 7,
}


@pytest.mark.parametrize("clock", CLOCKS)
def test_photographs_take_the_unit_interval_whatever_the_clock(clock: str) -> None:
    scene = scene_of(ring())
    other = in_another_world(scene, 1.0, np.zeros(3), lambda t: CLOCKS[clock](5 * t))
    # A stamp of 1.7e9 s is good to 1.2e-7 s, of 5 s.
    assert_same(normalised(scene), normalised(other), tolerance=1e-7)


@pytest.mark.parametrize("clock", CLOCKS)
def test_thirty_frames_of_a_film_are_a_unit_whatever_the_clock(clock: str) -> None:
    film = tiny_film(frames=6)
    other = in_another_world(film, 1.0, np.zeros(3), CLOCKS[clock])
    one, two = normalised(film), normalised(other)
    assert_same(one, two, tolerance=1e-6)  # 1.2e-7 of the film's half second
    assert one.frame_rate == pytest.approx(30.0) and one.time_start == 0.0
    assert one.train[1].time - one.train[0].time == pytest.approx(1 / 30)


def test_thirty_frames_a_second_are_seconds_exactly() -> None:
    film = replace(tiny_film(), frame_rate=30.0, duration=1.0)
    assert canonical_of(film).is_identity and normalised(film) is film
    # A rate told from times: 30 but for rounding.
    assert canonical_of(replace(film, frame_rate=30.0 * (1 + 1e-13))).is_identity
    assert canonical_of(tiny_film()).time_scale == RATE / 30


# --- what obeys the convention --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PHOTOGRAPHED)
def test_the_photographed_synthetic_scenes_are_left_as_they_are(name: str, tmp_path: Path) -> None:
    scene = read_dnerf(
        build_scene(tmp_path / name, scene=name, seed=0, size=16, train_views=8, test_views=2), name=name, downscale=1
    )
    assert canonical_of(scene).is_identity and normalised(scene) is scene
    assert (scene.unit, scene.init_box, scene.time_start, scene.duration) == (1.0, (-1.2, 1.2), 0.0, 1.0)


def test_only_what_is_near_the_convention_is_left() -> None:
    tiny = tiny_scene()  # cameras 4 from the origin, looking at it
    for scale, shift, left in (
        (1.0, 0.0, True),
        (1.09, 0.0, True),
        (1.12, 0.0, False),
        (0.88, 0.0, False),
        (1.0, 0.2, True),
        (1.0, 0.3, False),
    ):  # 0.3 √3 > 0.4
        cameras = [moved(view.camera, scale, np.full(3, shift)) for view in tiny.train]
        assert canonical_space(cameras).is_identity == left


def test_it_says_what_it_does_in_one_line() -> None:
    frame = Canonical((1e4, 0.0, -2.5), 0.001, 1.7e9, 1 / 3)
    assert str(frame) == "x → (x - (10000, 0, -2.5)) × 0.001, t → (t - 1700000000) × 0.333333"
    assert str(replace(frame, centre=(0.0, 0.0, 0.0), scale=1.0)) == "t → (t - 1700000000) × 0.333333"
    assert str(replace(frame, time_origin=0.0, time_scale=1.0)) == "x → (x - (10000, 0, -2.5)) × 0.001"
    assert frame.described()["centre"] == (1e4, 0.0, -2.5) and "canonical t" in frame.described()["meaning"]
