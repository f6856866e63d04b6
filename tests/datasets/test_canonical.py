"""Canonical coordinates: independence of the data's units and origin; the identity for scenes within the tolerance."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import dnerf_folder
import numpy as np
import pytest
from tiny import tiny_scene
from tiny_film import RATE, tiny_film

from datasets.canonical import DISTANCE, Canonical, canonical_of, canonical_space, canonicalise
from datasets.scene import Scene, View, camera_extent, validate_scene
from datasets.synthetic import PHOTOGRAPHED, build_scene
from pipeline.evaluation.pictures.camera_path import look_at
from rasterizer import Camera

DOWN = np.array([0.0, 1.0, 0.0])
SCALES, SHIFTS = (1e3, 1e-3, 0.7, 25.4), ((0.0, 0.0, 0.0), (1e4, -2e4, 5e3))
# float64: rounding near 2e4 is 4e-12, which is 4e-9 of a rig scaled by 1e-3; about ten roundings add up.
EXACT = 1e-7


def camera(position: np.ndarray, target: np.ndarray) -> Camera:
    return Camera(64, 48, 60.0, 61.0, 30.0, 25.0, look_at(np.asarray(position, float), np.asarray(target, float), DOWN))


def grid(distance: float = 5.0) -> list[Camera]:
    """5 × 3 cameras on a plane, with optical axes that nearly intersect."""
    generator = np.random.default_rng(0)
    return [
        camera((x, y, 2.0), np.array([0.3, -0.2, 2.0 + distance]) + 0.1 * generator.standard_normal(3))
        for x in (-1, -0.5, 0, 0.5, 1)
        for y in (-0.5, 0, 0.5)
    ]


def ring(outwards: bool = False) -> list[Camera]:
    """On a circle of radius 3 around (1, 2, 3), looking at its centre or away from it."""
    places = [3 * np.array([np.cos(a), 0.1, np.sin(a)]) for a in np.linspace(0, 2 * np.pi, 9)[:-1]]
    return [camera(p + (1, 2, 3), (3 * p if outwards else 0 * p) + (1, 2, 3)) for p in places]


def parallel() -> list[Camera]:
    return [camera((x, 0.1 * x, 1.0), (x, 0.1 * x, 9.0)) for x in (-1.0, 0.0, 0.5, 1.5)]


RIGS = {"grid": grid(), "ring": ring(), "outwards": ring(outwards=True), "parallel": parallel()}


def transformed_camera(c: Camera, scale: float, shift: np.ndarray) -> Camera:
    """The camera in a world where point x is at scale x + shift."""
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
        "monocular",
        unit=unit,
    )
    return replace(made, **changes)


def in_other_units(scene: Scene, scale: float, shift: np.ndarray, clock=lambda t: t) -> Scene:
    """The scene as read from files in other units."""

    def view_of(view: View) -> View:
        return replace(view, camera=transformed_camera(view.camera, scale, shift), time=clock(view.time))

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


def canonicalised(scene: Scene) -> Scene:
    return canonicalise(scene, canonical_of(scene))


def assert_equal_scenes(one: Scene, two: Scene, tolerance: float = EXACT) -> None:
    for a, b in zip(one.train + one.test, two.train + two.test, strict=True):
        np.testing.assert_allclose(b.camera.world_to_cam, a.camera.world_to_cam, atol=tolerance)
        assert b.time == pytest.approx(a.time, abs=tolerance) and b.image is a.image and b.name == a.name
        assert all(getattr(a.camera, k) == getattr(b.camera, k) for k in ("width", "height", "fx", "fy", "cx", "cy"))
    for name in ("duration", "time_start", "extent", "unit", "frame_rate"):
        if getattr(one, name) is not None:
            assert getattr(two, name) == pytest.approx(getattr(one, name), abs=tolerance), name
    box_of = [np.stack([np.broadcast_to(corner, 3) for corner in scene.init_box]) for scene in (one, two)]
    np.testing.assert_allclose(*box_of, atol=tolerance)


# --- space ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rig", RIGS)
@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("shift", SHIFTS)
def test_result_is_independent_of_unit_and_origin(rig: str, scale: float, shift: tuple) -> None:
    scene = scene_of(RIGS[rig])
    other = in_other_units(scene, scale, np.array(shift))
    assert not canonical_of(scene).is_identity
    one, two = canonicalised(scene), canonicalised(other)
    assert_equal_scenes(one, two)
    assert validate_scene(two) is two


@pytest.mark.parametrize("rig", RIGS)
def test_canonical_space_without_unit_is_independent_of_unit_and_origin(rig: str) -> None:
    """Readers of files without depth bounds take the canonical unit as Scene.unit."""
    transform = canonical_space(RIGS[rig])
    for scale in SCALES:
        for shift in SHIFTS:
            other = canonical_space([transformed_camera(c, scale, np.array(shift)) for c in RIGS[rig]])
            assert other.unit == pytest.approx(scale * transform.unit, rel=EXACT)
            np.testing.assert_allclose(
                other.points(scale * np.ones(3) + shift), transform.points(np.ones(3)), atol=EXACT
            )


@pytest.mark.parametrize(("rig", "centre"), [("grid", None), ("ring", (1, 2, 3))])
def test_origin_is_the_intersection_of_axes_at_mean_distance_4(rig: str, centre: tuple | None) -> None:
    transform = canonical_space(RIGS[rig], unit=123.0)  # not used: the axes intersect
    cameras = [transform.camera(c) for c in RIGS[rig]]
    assert np.mean([np.linalg.norm(c.position) for c in cameras]) == pytest.approx(DISTANCE)
    # Random search: no point near the origin has a smaller sum of squared distances.
    positions = np.stack([c.position for c in cameras])
    axes = np.stack([c.world_to_cam[2, :3] for c in cameras])

    def squared(point: np.ndarray) -> float:
        return float(np.sum(np.cross(point - positions, axes) ** 2))

    steps = np.random.default_rng(1).standard_normal((50, 3))
    assert all(squared(np.zeros(3)) < squared(1e-2 * step) for step in steps)
    if centre is not None:
        np.testing.assert_allclose(transform.centre, centre, atol=EXACT)


def test_parallel_axes_put_the_origin_4_units_ahead() -> None:
    transform = canonical_space(parallel(), unit=0.5)
    assert transform.unit == 0.5
    np.testing.assert_allclose(transform.centre, (0.25, 0.025, 1.0 + 4 * 0.5), atol=EXACT)
    assert canonical_space(parallel()).unit == pytest.approx(camera_extent(parallel()))


def test_outward_cameras_put_the_origin_at_their_mean() -> None:
    np.testing.assert_allclose(canonical_space(ring(outwards=True), unit=0.5).centre, (1, 2.3, 3), atol=EXACT)


def test_repeated_cameras_count_once() -> None:
    once, often = canonical_space(grid()), canonical_space(grid() + 50 * [grid()[0]])
    assert once == often


def test_projections_are_kept_and_depths_scale() -> None:
    transform = Canonical((1e4, 20.0, -3.0), 0.25)
    points = np.random.default_rng(2).normal(size=(20, 3)) + transform.centre
    c = transformed_camera(grid()[0], 1.0, np.array(transform.centre))
    before = c.world_to_cam[:3, :3] @ points.T + c.world_to_cam[:3, 3:]
    after = (
        transform.camera(c).world_to_cam[:3, :3] @ transform.points(points).T + transform.camera(c).world_to_cam[:3, 3:]
    )
    np.testing.assert_allclose(after, transform.scale * before, atol=EXACT)
    np.testing.assert_allclose(transform.camera(c).position, transform.points(c.position), atol=EXACT)
    np.testing.assert_allclose(transform.inverse.points(transform.points(points)), points, atol=1e-11)
    np.testing.assert_allclose(transform.inverse.camera(transform.camera(c)).world_to_cam, c.world_to_cam, atol=1e-11)


def test_box_round_trip() -> None:
    transform = Canonical((1e4, 20.0, -3.0), 0.25)
    world = transform.inverse.box((-1.2, 1.2))
    np.testing.assert_allclose(world, [(9995.2, 15.2, -7.8), (10004.8, 24.8, 1.8)])
    np.testing.assert_allclose(transform.box(world), [3 * (-1.2,), 3 * (1.2,)], atol=EXACT)
    assert Canonical(time_scale=2.0).box((-1.2, 1.2)) == (-1.2, 1.2)


def test_inverse() -> None:
    transform = Canonical((1e4, 20.0, -3.0), 0.25, 1.7e9, 0.2)
    assert transform.inverse.time(transform.time(1.7e9 + 3)) == pytest.approx(1.7e9 + 3, abs=1e-6)
    assert Canonical().inverse.is_identity


def test_map_coordinates_are_accepted() -> None:
    scene = scene_of(grid())
    far = validate_scene(in_other_units(scene, 1.0, np.array([5e5, 5e6, 100.0])))
    assert_equal_scenes(
        canonicalised(scene), canonicalised(far), tolerance=1e-6
    )  # rounding of positions near 5e6 is 1e-9


# --- time -------------------------------------------------------------------------------------------------------------

CLOCKS = {
    "frames": lambda s: 30 * s,
    "milliseconds": lambda s: 1000 * s,
    "epoch": lambda s: 1.7e9 + s,
    "minutes": lambda s: s / 60 + 7,
}


@pytest.mark.parametrize("clock", CLOCKS)
def test_times_of_photographs_become_the_unit_interval(clock: str) -> None:
    scene = scene_of(ring())
    other = in_other_units(scene, 1.0, np.zeros(3), lambda t: CLOCKS[clock](5 * t))
    # Rounding of times near 1.7e9 s is 1.2e-7 s, of 5 s.
    assert_equal_scenes(canonicalised(scene), canonicalised(other), tolerance=1e-7)


@pytest.mark.parametrize("clock", CLOCKS)
def test_30_video_frames_become_one_unit(clock: str) -> None:
    film = tiny_film(frames=6)
    other = in_other_units(film, 1.0, np.zeros(3), CLOCKS[clock])
    one, two = canonicalised(film), canonicalised(other)
    assert_equal_scenes(one, two, tolerance=1e-6)  # rounding of 1.2e-7 s, of half a second
    assert one.frame_rate == pytest.approx(30.0) and one.time_start == 0.0
    assert one.train[1].time - one.train[0].time == pytest.approx(1 / 30)


def test_30_frames_a_second_give_the_identity() -> None:
    film = replace(tiny_film(), frame_rate=30.0, duration=1.0)
    assert canonical_of(film).is_identity and canonicalised(film) is film
    # A rate computed from times: 30 up to rounding.
    assert canonical_of(replace(film, frame_rate=30.0 * (1 + 1e-13))).is_identity
    assert canonical_of(tiny_film()).time_scale == RATE / 30


# --- the identity -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PHOTOGRAPHED)
def test_photographed_synthetic_scenes_give_the_identity(name: str, tmp_path: Path) -> None:
    folder = build_scene(tmp_path / name, scene=name, seed=0, size=16, train_views=8, test_views=2)
    scene = dnerf_folder.read(folder, downscale=1)
    assert canonical_of(scene).is_identity and canonicalised(scene) is scene
    assert (scene.unit, scene.init_box, scene.time_start, scene.duration) == (1.0, (-1.2, 1.2), 0.0, 1.0)


def test_tolerance_of_the_identity() -> None:
    tiny = tiny_scene()  # cameras at distance 4 that look at the origin
    for scale, shift, expected in (
        (1.0, 0.0, True),
        (1.09, 0.0, True),
        (1.12, 0.0, False),
        (0.88, 0.0, False),
        (1.0, 0.2, True),
        (1.0, 0.3, False),
    ):  # 0.3 √3 > 0.4
        cameras = [transformed_camera(view.camera, scale, np.full(3, shift)) for view in tiny.train]
        assert canonical_space(cameras).is_identity == expected


def test_str_and_to_dict() -> None:
    transform = Canonical((1e4, 0.0, -2.5), 0.001, 1.7e9, 1 / 3)
    assert str(transform) == "x → (x - (10000, 0, -2.5)) × 0.001, t → (t - 1700000000) × 0.333333"
    assert str(replace(transform, centre=(0.0, 0.0, 0.0), scale=1.0)) == "t → (t - 1700000000) × 0.333333"
    assert str(replace(transform, time_origin=0.0, time_scale=1.0)) == "x → (x - (10000, 0, -2.5)) × 0.001"
    assert transform.to_dict()["centre"] == (1e4, 0.0, -2.5) and "canonical t" in transform.to_dict()["meaning"]
