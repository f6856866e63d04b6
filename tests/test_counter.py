"""The filmed scene: frames equal traced images, videos and poses say what was traced, nothing asked for is missing."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from datasets.scene import SceneError
from datasets.synthetic import build_scene, make_scene
from datasets.synthetic.__main__ import main
from datasets.synthetic.film import depth_of, film, to_pixels
from datasets.synthetic.rig import HALF_HEIGHT, HALF_WIDTH, RADIUS, grid, rig
from datasets.synthetic.scenes.counter import FAR
from datasets.synthetic.shapes import Dome, Rectangle, Sphere
from datasets.synthetic.texture import mosaic, plain
from datasets.synthetic.trace import trace
from datasets.synthetic.video import FRAME_RATE, write_video
from datasets.synthetic.world import Body, Light, Material, Pose, World, rest, steady
from datasets.synthetic.write_film import BACKDROP, Shooting
from rasterizer.camera import Camera

SMALL = {"scene": "counter", "size": 64, "cameras": 3, "frames": 4, "samples": 1}
RIG = Shooting(seed=0, scene="counter", size=96, cameras=12, frames=4, samples=3)


def all_bytes(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def read_video(path: Path) -> np.ndarray:
    """(frames, H, W, 3) RGB uint8."""
    video, frames = cv2.VideoCapture(str(path)), []
    while (frame := video.read()[1]) is not None:
        frames.append(frame[..., ::-1])
    return np.stack(frames)


@pytest.fixture(scope="module")
def set_up() -> tuple[World, list[Camera]]:
    return RIG.set_up()


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_scene(tmp_path_factory.mktemp("made") / "counter", seed=0, **SMALL)


# --- the rig --------------------------------------------------------------------------------------------------------

@pytest.mark.parametrize("count", range(3, 25))
def test_the_first_camera_stands_amid_the_others(count: int) -> None:
    places = grid(count)
    assert places.shape == (count, 2) and len(np.unique(places, axis=0)) == count
    assert places[0].tolist() == [0, 0] and np.abs(places).max(axis=0).tolist() <= [HALF_WIDTH, HALF_HEIGHT]
    assert places[:, 0].min() == -HALF_WIDTH and places[:, 0].max() == HALF_WIDTH
    if count >= 8:  # rows above and below
        assert places[:, 1].min() == -HALF_HEIGHT and places[:, 1].max() == HALF_HEIGHT


def test_all_cameras_look_at_the_origin_from_about_the_same_distance() -> None:
    cameras = rig(20, 64, 48, np.random.default_rng(0))
    assert len({(camera.width, camera.height, camera.fx, camera.fy) for camera in cameras}) == 1
    for camera in cameras:
        np.testing.assert_allclose((camera.world_to_cam @ [0, 0, 0, 1])[:3], [0, 0, RADIUS], atol=1e-9)
        assert (camera.world_to_cam[:3, :3] @ [0, 0, 1])[1] < -0.9  # upright: y points down


# --- new shapes and textures ----------------------------------------------------------------------------------------

def test_a_dome_is_met_from_inside() -> None:
    rng = np.random.default_rng(0)
    origin, direction = rng.uniform(-2, 2, (3, 1)).astype(np.float32), rng.normal(size=(3, 50)).astype(np.float32)
    distance = Dome(300.0).intersect(origin, direction)
    points = origin + distance * direction
    assert (distance > 0).all()
    np.testing.assert_allclose(np.linalg.norm(points, axis=0), 300, rtol=1e-5)
    assert ((Dome(300.0).normal(points) * direction).sum(axis=0) < 0).all()  # towards who looks


def test_a_rectangle_may_have_a_hole() -> None:
    x, y = np.meshgrid(np.linspace(-1.5, 1.5, 31), np.linspace(-1.5, 1.5, 31))
    origin = np.stack([x.ravel(), y.ravel(), np.full(x.size, 2.0)]).astype(np.float32)
    down = np.tile(np.float32([[0], [0], [-1]]), x.size)
    met = np.isfinite(Rectangle((1.02, 0.82), (-0.52, -0.22, 0.31, 0.63)).intersect(origin, down)).reshape(x.shape)
    whole = (np.abs(x) < 1.02) & (np.abs(y) < 0.82)
    np.testing.assert_array_equal(met, whole & ~((x > -0.52) & (x < 0.31) & (y > -0.22) & (y < 0.63)))


def test_a_mosaic_has_one_colour_a_cell() -> None:
    texture = mosaic((0.1, 0.2, 0.3), (0.9, 0.8, 0.7), 0.2, np.random.default_rng(0))
    centres = 0.2 * (np.random.default_rng(1).integers(-400, 400, (3, 500)) + 0.25)
    inside = centres + np.random.default_rng(2).uniform(-0.09, 0.09, centres.shape)
    colours = texture(centres.astype(np.float32))
    np.testing.assert_array_equal(colours, texture(inside.astype(np.float32)))
    assert colours.dtype == np.float32 and len(np.unique(colours[0])) > 150
    assert (colours >= np.float32([[0.1], [0.2], [0.3]]) - 1e-6).all()


# --- film = trace ---------------------------------------------------------------------------------------------------

def assert_filmed_as_traced(world: World, camera: Camera, times: list[float], samples: int) -> None:
    """Matrix products of differently cut arrays may differ in their last bit. That moves a colour by far less than a
    level, but at a texture's edge it may take a ray across: hence one ray in a pixel or two, and no more."""
    for time, frame in zip(times, film(world, camera, times, samples=samples), strict=True):
        traced = trace(world, camera, time, samples=samples)
        assert (traced.alpha == 1).all()
        difference = np.abs(frame.astype(int) - to_pixels(traced.color)).max(axis=-1)
        assert frame.dtype == np.uint8 and (difference > 1).sum() <= 2 and (difference > 0).mean() < 1e-3


@pytest.mark.parametrize("samples", [1, 3])
def test_a_filmed_frame_is_the_traced_image(samples: int, set_up: tuple[World, list[Camera]]) -> None:
    world, cameras = set_up
    assert_filmed_as_traced(world, cameras[3], [0.0, 0.9, 1 / 30], samples)


def balls(**options: bool) -> World:
    """Two that pass before and through each other, in an unlit sphere."""
    def going(way: float) -> Body:
        return Body(Sphere(0.4), Material(mosaic((0.1, 0.1, 0.1), (0.9, 0.9, 0.9), 0.1, np.random.default_rng(0)),
                                          glow=lambda time: np.array([0.0, 0.0, 0.5 * time])),
                    lambda time: Pose(np.array([way * (time - 0.5), 0.1 * way, 0.0]), np.eye(3)),
                    **{"casts_shadow": False, "changes": True, **options})
    shell = Body(Dome(50.0), Material(plain((0.2, 0.4, 0.6)), is_lit=False), rest((0, 0, 0)), casts_shadow=False)
    return World(bodies=(going(1.0), shell, going(-1.0)), lights=(Light((1.0, -4.0, 3.0), 0.2, steady(0.5, 0.5, 0.5)),))


def test_bodies_that_change_may_overlap_and_leave_nothing_behind() -> None:
    camera = rig(3, 64, 48, np.random.default_rng(0))[1]
    assert_filmed_as_traced(balls(), camera, [0.0, 0.45, 0.5, 4.0, 0.0], 3)  # at 4 out of sight
    first, *_, last = film(balls(), camera, [0.0, 0.5, 4.0, 0.0])
    np.testing.assert_array_equal(first, last)


def test_an_unlit_surface_shows_its_texture() -> None:
    frame = next(film(balls(), rig(3, 64, 48, np.random.default_rng(0))[0], [4.0]))
    assert (frame == [51, 102, 153]).all()


def test_what_film_would_show_wrongly_is_refused() -> None:
    camera = rig(3, 16, 12, np.random.default_rng(0))[0]
    flickering = Light((0.0, 0.0, 4.0), 0.1, lambda time: np.full(3, time))
    for world, times, samples, message in (
            (balls(casts_shadow=True), [0.0], 3, "change to cast no shadow, found one that does"),
            (replace(balls(), lights=(flickering,)), [0.0, 1.0], 3, "steady lights, found one that changes"),
            (replace(balls(), bodies=balls().bodies[:1]), [0.0], 3, "found a ray that meets nothing"),
            (balls(), [], 3, "times: expected one or more, found none"), (balls(), [0.0], 2, "samples: .* found 2")):
        with pytest.raises(ValueError, match=message):
            next(film(world, camera, times, samples=samples))


# --- what is to be seen ---------------------------------------------------------------------------------------------

def test_things_move_and_flicker(set_up: tuple[World, list[Camera]]) -> None:
    world, cameras = set_up
    times = np.arange(60) / FRAME_RATE
    moving = [body for body in world.bodies if np.ptp([body.motion(t).position for t in times], axis=0).max() > 0.3]
    glowing = [body for body in world.bodies if body.material.glow is not None]
    assert len(moving) >= 3 and len(glowing) >= 3
    assert all(body.changes and not body.casts_shadow for body in moving + glowing)
    fast = np.fft.rfftfreq(300, 1 / FRAME_RATE) > 10
    for body in glowing:
        power = np.abs(np.fft.rfft([body.material.glow(i / FRAME_RATE).sum() for i in range(300)]))[1:] ** 2
        assert power[fast[1:]].sum() > 0.1 * power.sum()
    depths = [depth_of(world, cameras[0], time) for time in times[::6]]
    assert 0.03 < (np.ptp(depths, axis=0) > 0).mean() < 0.4  # the image's part that something moves through


@pytest.mark.parametrize("seed", [0, 1])
def test_a_far_landscape_fills_part_of_every_image_and_hardly_shifts(seed: int) -> None:
    world, cameras = replace(RIG, size=320, seed=seed).set_up()
    middle = cameras[0]
    for camera in cameras:
        depth = depth_of(world, camera.resized(96, 72), 0.0)
        assert 0.10 <= (depth > BACKDROP).mean() <= 0.25 and depth[depth < BACKDROP].max() < 8
    # A landscape point as seen from the middle, and where a camera there with another's rotation would see it.
    point = middle.position + FAR * middle.world_to_cam[2, :3]
    for camera in cameras:
        seen, turned = (camera.world_to_cam[:3, :3] @ (point - eye) for eye in (camera.position, middle.position))
        assert np.linalg.norm(camera.fx * (seen[:2] / seen[2] - turned[:2] / turned[2])) < 1.0  # pixels


def test_what_stands_still_is_rich_in_features() -> None:
    world, cameras = replace(RIG, size=320).set_up()
    camera = cameras[0]
    grey = cv2.cvtColor(next(film(world, camera, [0.0], samples=1)), cv2.COLOR_RGB2GRAY)
    still = replace(world, bodies=tuple(body for body in world.bodies if not body.changes))
    depth = depth_of(world, camera, 0.0)
    is_still = (depth == depth_of(still, camera, 0.0)) & (depth < BACKDROP)
    places = np.array([point.pt for point in cv2.SIFT_create().detect(grey)]).round().astype(int)
    assert is_still[places[:, 1], places[:, 0]].sum() > 500


# --- on disk --------------------------------------------------------------------------------------------------------

def test_a_seed_gives_the_same_bytes_however_many_processes(scene: Path, tmp_path: Path) -> None:
    done = []
    again = build_scene(tmp_path / "again", seed=0, processes=2, progress=lambda *both: done.append(both), **SMALL)
    other = build_scene(tmp_path / "other", seed=1, **SMALL)
    assert all_bytes(again) == all_bytes(scene) and done == [(1, 3), (2, 3), (3, 3)]
    assert all(content != all_bytes(scene)[name] for name, content in all_bytes(other).items())
    assert sorted(all_bytes(scene)) == ["cam00.mp4", "cam01.mp4", "cam02.mp4", "meta.json", "poses_bounds.npy",
                                        *(f"truth/cam0{number}_depth.npy" for number in range(3))]


def test_videos_decode_to_what_was_traced(tmp_path: Path, set_up: tuple[World, list[Camera]]) -> None:
    world, cameras = set_up
    frames = np.stack(list(film(world, cameras[0], RIG.times)))
    write_video(tmp_path / "a.mp4", frames, RIG.size, RIG.height)
    video = cv2.VideoCapture(str(tmp_path / "a.mp4"))
    assert video.get(cv2.CAP_PROP_FPS) == FRAME_RATE and int(video.get(cv2.CAP_PROP_FRAME_COUNT)) == RIG.frames
    assert int(video.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little") in (b"h264", b"avc1")
    error = read_video(tmp_path / "a.mp4").astype(float) - frames
    # OpenCV's conversion from YUV rounds down, which costs a level; colour at half the resolution costs most where
    # textures are as fine as here.
    assert np.abs(error).mean() < 4 and np.abs(error.mean(axis=(0, 1, 2))).max() < 2
    grey = error @ [0.299, 0.587, 0.114]
    assert np.abs(grey).mean() < 2
    # No frame may be taken for its neighbour.
    moved = np.abs(np.diff(frames.astype(float), axis=0)).max(axis=-1) > 60
    assert moved.any() and np.abs(grey[1:][moved]).mean() < 6


def test_flat_colours_survive_the_video(tmp_path: Path) -> None:
    """A wrong matrix or range would shift them by ten levels and more."""
    colours = np.random.default_rng(0).integers(8, 248, (6, 8, 3)).astype(np.uint8)
    image = colours.repeat(16, axis=0).repeat(16, axis=1)
    write_video(tmp_path / "flat.mp4", [image, image], 128, 96)
    decoded = read_video(tmp_path / "flat.mp4")[:, 8::16, 8::16].astype(int)
    assert np.abs(decoded - colours).max() <= 5 and np.abs(decoded - colours).mean() < 1.5


def test_a_video_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="a.mp4: expected ffmpeg to write it, found exit status .*No such file") as caught:
        write_video(tmp_path / "no" / "a.mp4", [np.zeros((16, 16, 3), np.uint8)] * 50, 16, 16)
    assert "\n" not in str(caught.value)


def test_depth_and_bounds_are_those_of_the_first_frame(scene: Path) -> None:
    world, cameras = Shooting(seed=0, **SMALL).set_up()
    poses = np.load(scene / "poses_bounds.npy")
    assert poses.shape == (3, 17) and poses.dtype == np.float64
    for number, (camera, row) in enumerate(zip(cameras, poses)):
        depth = np.load(scene / "truth" / f"cam{number:02d}_depth.npy")
        assert depth.shape == (48, 64) and depth.dtype == np.float32 and np.isfinite(depth).all()
        # The same rays in two ways: float32 (6e-8), magnified where a surface is seen at a slant.
        np.testing.assert_allclose(depth, trace(world, camera, 0.0, samples=1).depth, rtol=1e-5)
        kitchen = depth[depth < BACKDROP]
        assert row[15] == kitchen.min() and row[16] == kitchen.max()


def test_poses_take_a_pixel_of_one_camera_to_the_same_place_in_another(scene: Path) -> None:
    """From the file alone, by LLFF's words: columns down, right, backward, centre, (height, width, focal)."""
    rows = np.load(scene / "poses_bounds.npy")[:, :15].reshape(3, 3, 5)
    depths = [np.load(scene / "truth" / f"cam{number:02d}_depth.npy") for number in range(3)]
    j, i = np.mgrid[:48, :64]
    for source, target in ((0, 1), (0, 2), (2, 1)):
        down, right, backward, centre, (height, width, focal) = rows[source].T
        assert (height, width) == (48, 64)
        ray = ((i + 0.5 - width / 2) / focal)[..., None] * right + ((j + 0.5 - height / 2) / focal)[..., None] * down
        points = centre + depths[source][..., None] * (ray - backward)
        down, right, backward, centre, _ = rows[target].T
        z = -(points - centre) @ backward
        x = focal * ((points - centre) @ right) / z + width / 2
        y = focal * ((points - centre) @ down) / z + height / 2
        inside = (x > 0) & (x < width) & (y > 0) & (y < height)
        expected = depths[target][y[inside].astype(int), x[inside].astype(int)]
        # The rest is hidden from the target, or lies half a pixel beside an edge of it.
        assert inside.mean() > 0.6 and (np.abs(expected / z[inside] - 1) < 0.03).mean() > 0.8
        np.testing.assert_allclose(focal, 0.85 * 64)


def test_a_broken_run_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("datasets.synthetic.write_film.write_video", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        build_scene(tmp_path / "counter", seed=0, **SMALL)
    assert list(tmp_path.iterdir()) == []


# --- dispatch -------------------------------------------------------------------------------------------------------

def test_the_cache_tells_apart_what_matters_to_a_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[dict] = []
    monkeypatch.setattr("datasets.synthetic.build_scene", lambda folder, **options: made.append(options))
    def names(scene: str, *changes: dict) -> int:
        return len({make_scene(scene, tmp_path, **change) for change in ({}, *changes)})
    assert names("counter", {"cameras": 4}, {"frames": 5}, {"size": 64}, {"seed": 1}) == 5
    assert names("counter", {"train_views": 4}, {"test_views": 5}) == 1
    assert names("wheel", {"cameras": 4}, {"frames": 5}) == 1
    assert made[0] == {"scene": "counter", "seed": 0, "size": 200, "cameras": 12, "frames": 60, "processes": 1,
                       "progress": None}


@pytest.mark.parametrize(("changes", "message"), [
    ({"size": 63}, "scene.size: expected an even number, at least 16, found 63"),
    ({"size": 8}, "scene.size: expected an even number, at least 16, found 8"),
    ({"cameras": 2}, "scene.cameras: expected at least 3, found 2"),
    ({"frames": 0}, "scene.frames: expected at least 1, found 0"),
    ({"samples": 2}, "samples: expected an odd number of rays along a pixel's side, found 2"),
    ({"processes": 0}, "processes: expected at least 1, found 0")])
def test_arguments_out_of_range_are_one_line(changes: dict, message: str, tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=f"^{re.escape(message)}$"):
        build_scene(tmp_path / "counter", seed=0, **{**SMALL, **changes})
    assert list(tmp_path.iterdir()) == []


def test_height_is_three_quarters_and_even() -> None:
    assert [replace(RIG, size=size).height for size in (320, 1352, 200, 100, 64)] == [240, 1014, 150, 76, 48]


def test_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["counter", "--out", str(tmp_path / "out"), "--size", "32", "--cameras", "3", "--frames", "2",
               "--samples", "1", "--processes", "1"]
    assert main(options) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[:3] == ["1/3 cameras", "2/3 cameras", "3/3 cameras"]
    assert "3 cameras, 2 frames each, 32 pixels wide" in lines[3] and len(lines) == 4
    assert len(read_video(tmp_path / "out" / "cam02.mp4")) == 2


def test_only_who_films_needs_the_encoder() -> None:
    code = "import sys, datasets.synthetic.__main__; sys.exit('imageio_ffmpeg' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
