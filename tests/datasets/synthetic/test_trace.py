"""The ray tracer against closed forms: intersections, depth, alpha, flow, shading, textures."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from datasets.synthetic.camera_path import ANGLE_X, look_at_origin
from datasets.synthetic.shade import place, shade
from datasets.synthetic.shapes import Box, Rectangle, Ring, Shape, Sphere
from datasets.synthetic.texture import checker, marble, mottled, plain, sectors, stripes, tiles
from datasets.synthetic.trace import trace
from datasets.synthetic.world import Body, Light, Material, Pose, World, rest, steady, turn
from rasterizer.camera import Camera

SIZE = 40
FOCAL = 0.5 * SIZE / np.tan(0.5 * ANGLE_X)
WHITE = Material(plain((1.0, 1.0, 1.0)))


def camera_at(x: float, y: float, z: float) -> Camera:
    return Camera.from_blender(SIZE, SIZE, FOCAL, look_at_origin(np.array([x, y, z])))


def world_of(*bodies: Body, lights: tuple[Light, ...] = ()) -> World:
    return World(bodies=bodies, lights=lights)


def world_rays(camera: Camera) -> np.ndarray:
    """(H, W, 3) float64 directions through the pixels' centres, length 1 along the viewing axis."""
    x, y = (np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5) - np.array(SIZE / 2)) / FOCAL
    return np.stack([x, y, np.ones_like(x)], axis=-1) @ camera.world_to_cam[:3, :3]


# --- shapes -----------------------------------------------------------------------------------------------------------

SOLIDS: dict[str, tuple[Shape, Callable[[np.ndarray], np.ndarray]]] = {  # with its indicator function for points (3, …)
    "sphere": (Sphere(0.7), lambda p: (p**2).sum(axis=0) < 0.7**2),
    "box": (Box((0.3, 0.5, 0.7)), lambda p: (np.abs(p.T) < (0.3, 0.5, 0.7)).all(axis=-1).T),
    "ring": (Ring(0.4, 0.8, 0.2), lambda p: (abs(p[2]) < 0.2) & (np.hypot(*p[:2]) > 0.4) & (np.hypot(*p[:2]) < 0.8)),
    "cylinder": (Ring(0.0, 0.6, 0.5), lambda p: (np.abs(p[2]) < 0.5) & (np.hypot(*p[:2]) < 0.6)),
}


@pytest.mark.parametrize("name", SOLIDS)
def test_intersections_by_ray_marching(name: str) -> None:
    """Ray marching in small steps finds the solid at the hit and not before."""
    shape, inside = SOLIDS[name]
    rng = np.random.default_rng(0)
    origin = rng.normal(size=(3, 400))
    origin *= 3 / np.linalg.norm(origin, axis=0)
    direction = rng.uniform(-0.8, 0.8, size=(3, 400)) - origin  # hits and misses
    distance = shape.intersect(origin.astype(np.float32), direction.astype(np.float32))
    hit = (distance > 0) & np.isfinite(distance)
    assert 50 < hit.sum() < 390

    steps = np.linspace(0, 2, 1500)
    met = inside(origin[..., None] + direction[..., None] * steps)  # (400, steps)
    first = np.where(met.any(axis=1), steps[met.argmax(axis=1)], np.inf)
    step = steps[1] * 1.01
    both = hit & met.any(axis=1)
    assert (first[both] >= distance[both] - 1e-5).all()  # nothing before the hit
    # Ray marching may miss corners shorter than a step.
    assert (first[both] <= distance[both] + step).mean() > 0.98
    assert (hit & ~met.any(axis=1)).mean() < 0.02 and not (met.any(axis=1) & ~hit).any()

    points = (origin + distance * direction)[:, hit]
    normal = shape.normal(points.astype(np.float32))
    np.testing.assert_allclose(np.linalg.norm(normal, axis=0), 1, atol=1e-5)
    assert inside(points - 1e-3 * normal).mean() > 0.98 and not inside(points + 1e-3 * normal).any()
    assert (np.linalg.norm(points, axis=0) <= shape.radius + 1e-5).all()


def test_depth_of_a_sphere() -> None:
    centre, radius = np.array([0.2, -0.3, 0.1]), 0.6
    camera = camera_at(2.0, -3.0, 1.5)
    depth = trace(world_of(Body(Sphere(radius), WHITE, rest(tuple(centre)))), camera, 0.0).depth

    rays, offset = world_rays(camera), camera.position - centre
    a, b, c = (rays**2).sum(-1), rays @ offset, offset @ offset - radius**2
    discriminant = b**2 - a * c
    expected = np.where(discriminant > 0, (-b - np.sqrt(np.maximum(discriminant, 0))) / a, 0)
    sure = np.abs(discriminant) > 1e-3  # not for grazing rays, which float32 may hit or miss
    assert 100 < (depth > 0).sum() < SIZE**2
    # float32 rounding of 4 world units is 5e-7; near the silhouette the square root increases it tenfold.
    np.testing.assert_allclose(depth[sure], expected[sure], atol=1e-5)


def test_depth_of_a_tilted_rectangle() -> None:
    camera, tilt = camera_at(1.0, 2.0, 3.0), turn("z", 0.4) @ turn("x", 0.5)
    depth = trace(world_of(Body(Rectangle((40.0, 40.0)), WHITE, rest((0.1, 0.2, -0.1), tilt))), camera, 0.0).depth
    normal = tilt[:, 2]
    expected = ((np.array([0.1, 0.2, -0.1]) - camera.position) @ normal) / (world_rays(camera) @ normal)
    # float32 rounding (6e-8), larger at grazing angles.
    np.testing.assert_allclose(depth, expected, rtol=3e-6)


def test_nearest_body_is_visible() -> None:
    red, green = (Material(plain(colour), glow=steady(*colour)) for colour in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    behind, front = Body(Sphere(0.5), red, rest((-1.0, 0, 0))), Body(Sphere(0.2), green, rest((1.0, 0, 0)))
    for bodies in ((behind, front), (front, behind)):  # in any order
        image = trace(world_of(*bodies), camera_at(4.0, 0.0, 0.0), 0.0).color
        assert image[1, SIZE // 2, SIZE // 2] > 0.9 and image[0, SIZE // 2, SIZE // 2] < 0.1


def test_alpha_is_the_covered_area() -> None:
    traced = trace(world_of(Body(Sphere(0.8), WHITE, rest((0, 0, 0)))), camera_at(0.0, -4.0, 0.0), 0.0)
    radius = FOCAL * 0.8 / np.sqrt(4.0**2 - 0.8**2)  # of the sphere's silhouette, pixels
    # 9 samples per pixel along a silhouette of 70 pixels: an error far below 1 %.
    assert traced.alpha.sum() == pytest.approx(np.pi * radius**2, rel=0.01)
    assert ((traced.alpha > 0) & (traced.alpha < 1)).any()
    assert (traced.color <= traced.alpha + 1e-6).all()


def test_even_number_of_samples_is_refused() -> None:
    with pytest.raises(ValueError, match="samples: expected an odd number .* found 2"):
        trace(world_of(), camera_at(4.0, 0.0, 0.0), 0.0, samples=2)


# --- flow -------------------------------------------------------------------------------------------------------------


def spinning(time: float) -> Pose:
    """Rotates about the vertical axis through (0.2, 0.1, 0) by 3 radians per unit of time, and rises."""
    return Pose(np.array([0.2, 0.1, 0.5 * time]), turn("z", 3.0 * time))


@pytest.mark.parametrize("shape", [Box((0.5, 0.3, 0.4)), Ring(0.3, 0.7, 0.2)])
def test_flow_is_the_projected_motion_of_the_surface(shape: Shape) -> None:
    camera, dt = camera_at(2.5, -2.5, 2.0), 0.05
    traced = trace(world_of(Body(shape, WHITE, spinning)), camera, 0.3, flow_dt=dt)
    visible = traced.depth > 0
    assert visible.sum() > 60 and (traced.flow_valid == visible).all()

    points = (camera.position + traced.depth[..., None] * world_rays(camera))[visible]  # in the world, at 0.3
    c, s = np.cos(3.0 * dt), np.sin(3.0 * dt)
    moved = (points - [0.2, 0.1, 0]) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + [0.2, 0.1, 0.5 * dt]

    def project(world_points: np.ndarray) -> np.ndarray:
        in_camera = world_points @ camera.world_to_cam[:3, :3].T + camera.world_to_cam[:3, 3]
        return FOCAL * in_camera[:, :2] / in_camera[:, 2:]

    # Rounding of float32 depth: 1e-6 world units are 1e-5 pixels here; with a margin of 10.
    np.testing.assert_allclose(traced.flow[:, visible].T, project(moved) - project(points), atol=1e-4)
    assert (traced.flow[:, ~visible] == 0).all()


def test_vanishing_body_has_no_flow() -> None:
    def vanishing(time: float) -> Pose:
        return Pose(np.zeros(3), np.eye(3), scale=1.0 if time < 0.5 else 0.0)

    traced = trace(world_of(Body(Sphere(0.5), WHITE, vanishing)), camera_at(4.0, 0.0, 0.0), 0.49, flow_dt=0.02)
    assert (traced.depth > 0).any() and not traced.flow_valid.any() and (traced.flow == 0).all()


# --- shading ----------------------------------------------------------------------------------------------------------


def test_light_and_shadow_on_a_floor() -> None:
    """In the shadow only ambient light; outside it also Lambert's cosine law."""
    light = Light((0.0, 0.0, 10.0), 0.0, steady(0.5, 0.5, 0.5))
    floor, ball = Body(Rectangle((2.0, 2.0)), WHITE, rest((0, 0, 0))), Body(Sphere(0.3), WHITE, rest((0, 0, 1.0)))
    world = World(bodies=(floor, ball), lights=(light,), sky=(0.2, 0.3, 0.4), ground=(0.0, 0.0, 0.0))
    points = np.array([[0.0, 0.0, 0.0], [1.5, 0.0, 0.0], [0.32, 0.0, 0.0], [0.36, 0.0, 0.0]], dtype=np.float32).T
    up = np.tile(np.array([[0.0], [0.0], [1.0]], dtype=np.float32), 4)
    placed = place(world, 0.0)
    colour = shade(placed[0], points, points, up, np.zeros(4, dtype=int), 1, placed, world, 0.0)
    np.testing.assert_allclose(colour[:, 0], (0.2, 0.3, 0.4), atol=1e-6)
    np.testing.assert_allclose(colour[:, 1], np.array([0.2, 0.3, 0.4]) + 0.5 * 10 / np.hypot(10, 1.5), atol=1e-5)
    # The shadow's edge: tangent from the light at 0.3 / √(9² - 0.3²) · 10 = 0.3335.
    assert colour[0, 2] == pytest.approx(0.2) and colour[0, 3] > 0.6


def test_penumbra_of_an_area_light() -> None:
    """Light of radius ½ at height 4, an edge at x = 0.3 and height 1: by similar triangles the penumbra on the floor is
    centred at x = 0.3 · 4/3 = 0.4 and extends ½ · 1/3 to either side."""
    light = Light((0.0, 0.0, 4.0), 0.5, steady(1.0, 1.0, 1.0))
    floor = Body(Rectangle((2.0, 2.0)), WHITE, rest((0, 0, 0)))
    screen = Body(Rectangle((0.3, 5.0)), WHITE, rest((0, 0, 1)))
    world = World(bodies=(floor, screen), lights=(light,), sky=(0.0, 0.0, 0.0))
    placed = place(world, 0.0)
    x = np.repeat(np.linspace(0.2, 0.6, 41), 9)
    points = np.stack([x, 0 * x, 0 * x]).astype(np.float32)
    up = np.zeros_like(points) + np.float32([[0], [0], [1]])
    lit = shade(placed[0], points, points, up, np.tile(np.arange(9), 41), 9, placed, world, 0.0)[0] > 0
    x, lit = x[::9], lit.reshape(-1, 9).mean(axis=1)
    assert (lit[x < 0.4 - 1 / 6] == 0).all() and (lit[x > 0.4 + 1 / 6] == 1).all()
    assert (np.diff(lit) >= 0).all() and len(np.unique(lit)) >= 8  # gradual, in steps of a ninth
    assert lit[np.abs(x - 0.4).argmin()] == pytest.approx(0.5, abs=1.5 / 9)


def test_only_specular_surfaces_depend_on_the_viewing_direction() -> None:
    light = Light((2.0, 0.0, 4.0), 0.3, steady(0.6, 0.6, 0.6))
    point = np.array([[0.0], [0.0], [0.5]], dtype=np.float32)
    sample = np.zeros(1, dtype=int)

    def colour(specular: float, eye: tuple[float, float, float]) -> np.ndarray:
        world = world_of(
            Body(Sphere(0.5), Material(plain((0.4, 0.4, 0.4)), specular=specular), rest((0, 0, 0))), lights=(light,)
        )
        toward_eye = (np.array(eye) / np.linalg.norm(eye)).astype(np.float32)[:, None]
        placed = place(world, 0.0)
        return shade(placed[0], point, point, toward_eye, sample, 9, placed, world, 0.0)

    mirror, aside = (-2.0, 0.0, 3.5), (0.0, 3.0, 2.0)
    np.testing.assert_array_equal(colour(0.0, mirror), colour(0.0, aside))
    assert (colour(0.5, mirror) > colour(0.5, aside) + 0.2).all()


@pytest.mark.parametrize(
    "texture",
    [
        plain((0.1, 0.5, 0.9)),
        checker(plain((0.0, 0.0, 0.0)), plain((1.0, 1.0, 1.0)), 0.2),
        tiles(plain((0.0, 0.0, 0.0)), plain((1.0, 1.0, 1.0)), 0.2),
        sectors([plain((0.0, 0.0, 0.0))] * 3),
        stripes(plain((0.0, 0.0, 0.0)), plain((1.0, 1.0, 1.0)), 0.1, (1, 2, 3)),
        mottled((0.0, 0.1, 0.2), (1.0, 0.9, 0.8), 0.1, np.random.default_rng(0)),
        marble((0.0, 0.1, 0.2), (1.0, 0.9, 0.8), 0.1, np.random.default_rng(0)),
    ],
)
def test_textures(texture: Callable[[np.ndarray], np.ndarray]) -> None:
    points = np.random.default_rng(1).uniform(-1.2, 1.2, (3, 500)).astype(np.float32)
    colours = texture(points)
    assert colours.shape == (3, 500) and np.isfinite(colours).all() and (colours >= 0).all() and (colours <= 1).all()
    # The colour of a point does not depend on its index.
    np.testing.assert_allclose(texture(points[:, ::-1])[:, ::-1], colours, atol=1e-5)
