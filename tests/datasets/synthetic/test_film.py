"""film() against trace(), and the encoding of videos."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from datasets.synthetic.film import film, to_pixels
from datasets.synthetic.rig import rig
from datasets.synthetic.shapes import Dome, Rectangle, Sphere
from datasets.synthetic.texture import mosaic, plain
from datasets.synthetic.trace import trace
from datasets.synthetic.video import FRAME_RATE, write_video
from datasets.synthetic.world import Body, Light, Material, Pose, World, rest, steady
from datasets.synthetic.write_film import FilmSettings
from rasterizer.camera import Camera

RIG = FilmSettings(seed=0, scene="counter", size=96, cameras=12, frames=4, samples=3)


def read_video(path: Path) -> np.ndarray:
    """(frames, H, W, 3) RGB uint8."""
    video, frames = cv2.VideoCapture(str(path)), []
    while (frame := video.read()[1]) is not None:
        frames.append(frame[..., ::-1])
    return np.stack(frames)


@pytest.fixture(scope="module")
def set_up() -> tuple[World, list[Camera]]:
    return RIG.set_up()


def test_dome_intersection_from_inside() -> None:
    rng = np.random.default_rng(0)
    origin, direction = rng.uniform(-2, 2, (3, 1)).astype(np.float32), rng.normal(size=(3, 50)).astype(np.float32)
    distance = Dome(300.0).intersect(origin, direction)
    points = origin + distance * direction
    assert (distance > 0).all()
    np.testing.assert_allclose(np.linalg.norm(points, axis=0), 300, rtol=1e-5)
    assert ((Dome(300.0).normal(points) * direction).sum(axis=0) < 0).all()  # towards the camera


def test_rectangle_with_a_hole() -> None:
    x, y = np.meshgrid(np.linspace(-1.5, 1.5, 31), np.linspace(-1.5, 1.5, 31))
    origin = np.stack([x.ravel(), y.ravel(), np.full(x.size, 2.0)]).astype(np.float32)
    down = np.tile(np.float32([[0], [0], [-1]]), x.size)
    met = np.isfinite(Rectangle((1.02, 0.82), (-0.52, -0.22, 0.31, 0.63)).intersect(origin, down)).reshape(x.shape)
    whole = (np.abs(x) < 1.02) & (np.abs(y) < 0.82)
    np.testing.assert_array_equal(met, whole & ~((x > -0.52) & (x < 0.31) & (y > -0.22) & (y < 0.63)))


def test_mosaic_has_one_colour_per_cell() -> None:
    texture = mosaic((0.1, 0.2, 0.3), (0.9, 0.8, 0.7), 0.2, np.random.default_rng(0))
    centres = 0.2 * (np.random.default_rng(1).integers(-400, 400, (3, 500)) + 0.25)
    inside = centres + np.random.default_rng(2).uniform(-0.09, 0.09, centres.shape)
    colours = texture(centres.astype(np.float32))
    np.testing.assert_array_equal(colours, texture(inside.astype(np.float32)))
    assert colours.dtype == np.float32 and len(np.unique(colours[0])) > 150
    assert (colours >= np.float32([[0.1], [0.2], [0.3]]) - 1e-6).all()


def assert_film_equals_trace(world: World, camera: Camera, times: list[float], samples: int) -> None:
    """Equal up to rounding of matrix products, which may move single rays across the edge of a texture."""
    for time, frame in zip(times, film(world, camera, times, samples=samples), strict=True):
        traced = trace(world, camera, time, samples=samples)
        assert (traced.alpha == 1).all()
        difference = np.abs(frame.astype(int) - to_pixels(traced.color)).max(axis=-1)
        assert frame.dtype == np.uint8 and (difference > 1).sum() <= 2 and (difference > 0).mean() < 1e-3


@pytest.mark.parametrize("samples", [1, 3])
def test_film_equals_trace(samples: int, set_up: tuple[World, list[Camera]]) -> None:
    world, cameras = set_up
    assert_film_equals_trace(world, cameras[3], [0.0, 0.9, 1 / 30], samples)


def balls(**options: bool) -> World:
    """Two balls that pass in front of and through each other, in an unlit sphere."""

    def ball(way: float) -> Body:
        return Body(
            Sphere(0.4),
            Material(
                mosaic((0.1, 0.1, 0.1), (0.9, 0.9, 0.9), 0.1, np.random.default_rng(0)),
                glow=lambda time: np.array([0.0, 0.0, 0.5 * time]),
            ),
            lambda time: Pose(np.array([way * (time - 0.5), 0.1 * way, 0.0]), np.eye(3)),
            **{"casts_shadow": False, "changes": True, **options},
        )

    shell = Body(Dome(50.0), Material(plain((0.2, 0.4, 0.6)), is_lit=False), rest((0, 0, 0)), casts_shadow=False)
    return World(bodies=(ball(1.0), shell, ball(-1.0)), lights=(Light((1.0, -4.0, 3.0), 0.2, steady(0.5, 0.5, 0.5)),))


def test_overlapping_changing_bodies() -> None:
    camera = rig(3, 64, 48, np.random.default_rng(0))[1]
    assert_film_equals_trace(balls(), camera, [0.0, 0.45, 0.5, 4.0, 0.0], 3)  # at time 4 outside the image
    first, *_, last = film(balls(), camera, [0.0, 0.5, 4.0, 0.0])
    np.testing.assert_array_equal(first, last)


def test_unlit_surface_shows_its_texture() -> None:
    frame = next(film(balls(), rig(3, 64, 48, np.random.default_rng(0))[0], [4.0]))
    assert (frame == [51, 102, 153]).all()


def test_unsupported_worlds_are_refused() -> None:
    camera = rig(3, 16, 12, np.random.default_rng(0))[0]
    flickering = Light((0.0, 0.0, 4.0), 0.1, lambda time: np.full(3, time))
    for world, times, samples, message in (
        (balls(casts_shadow=True), [0.0], 3, "change to cast no shadow, found one that does"),
        (replace(balls(), lights=(flickering,)), [0.0, 1.0], 3, "steady lights, found one that changes"),
        (replace(balls(), bodies=balls().bodies[:1]), [0.0], 3, "found a ray that meets nothing"),
        (balls(), [], 3, "times: expected one or more, found none"),
        (balls(), [0.0], 2, "samples: .* found 2"),
    ):
        with pytest.raises(ValueError, match=message):
            next(film(world, camera, times, samples=samples))


def test_video_decodes_to_the_traced_frames(tmp_path: Path, set_up: tuple[World, list[Camera]]) -> None:
    world, cameras = set_up
    frames = np.stack(list(film(world, cameras[0], RIG.times)))
    write_video(tmp_path / "a.mp4", frames, RIG.size, RIG.height)
    video = cv2.VideoCapture(str(tmp_path / "a.mp4"))
    assert video.get(cv2.CAP_PROP_FPS) == FRAME_RATE and int(video.get(cv2.CAP_PROP_FRAME_COUNT)) == RIG.frames
    assert int(video.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little") in (b"h264", b"avc1")
    error = read_video(tmp_path / "a.mp4").astype(float) - frames
    # OpenCV's conversion from YUV rounds down, by one level; the rest is chroma subsampling of fine textures.
    assert np.abs(error).mean() < 4 and np.abs(error.mean(axis=(0, 1, 2))).max() < 2
    grey = error @ [0.299, 0.587, 0.114]
    assert np.abs(grey).mean() < 2
    # Frames must not be shifted in time.
    moved = np.abs(np.diff(frames.astype(float), axis=0)).max(axis=-1) > 60
    assert moved.any() and np.abs(grey[1:][moved]).mean() < 6


def test_flat_colours_survive_encoding(tmp_path: Path) -> None:
    """A wrong colour matrix or range would shift them by ten levels or more."""
    colours = np.random.default_rng(0).integers(8, 248, (6, 8, 3)).astype(np.uint8)
    image = colours.repeat(16, axis=0).repeat(16, axis=1)
    write_video(tmp_path / "flat.mp4", [image, image], 128, 96)
    decoded = read_video(tmp_path / "flat.mp4")[:, 8::16, 8::16].astype(int)
    assert np.abs(decoded - colours).max() <= 5 and np.abs(decoded - colours).mean() < 1.5


def test_encoder_error_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="a.mp4: expected ffmpeg to write it, found exit status .*No such file") as caught:
        write_video(tmp_path / "no" / "a.mp4", [np.zeros((16, 16, 3), np.uint8)] * 50, 16, 16)
    assert "\n" not in str(caught.value)
