"""Structure from motion on ray-traced photographs, with exact ground truth of cameras, distortion and surfaces."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from datasets.scene import camera_extent
from datasets.source import Photograph
from datasets.synthetic.film import depth_of, film
from datasets.synthetic.world import World
from datasets.synthetic.write_film import FilmSettings
from pipeline.config.schema import InitConfig
from pipeline.data.sfm.__main__ import main, read_photographs
from pipeline.data.sfm.cache import CLIP_VERSION, fingerprint, load, reconstruct_cached, save
from pipeline.data.sfm.job import image_file, photograph_name
from pipeline.data.sfm.reconstruction import CalibratedCamera, Reconstruction
from pipeline.data.sfm.run import reconstruct
from rasterizer import Camera

FILM = FilmSettings(scene="counter", seed=1, size=320, cameras=11, frames=1, samples=3)
RADIAL = 0.1  # distortion x → x (1 + RADIAL |x|²): 5 % at the corner of a photograph, 10 pixels
CFG = InitConfig(max_features=1000)
FEW = InitConfig(max_features=800, min_points=10)
SOURCE = Path("photographs")
HELD_OUT = 2


@pytest.fixture(scope="module")
def world() -> World:
    return FILM.set_up()[0]


@pytest.fixture(scope="module")
def posed(world: World) -> list[Photograph]:
    """Of pinhole cameras with known poses."""
    return [
        Photograph(f"p{i:02d}", next(film(world, camera, FILM.times, samples=FILM.samples)), camera)
        for i, camera in enumerate(FILM.set_up()[1])
    ]


@pytest.fixture(scope="module")
def known(posed: list[Photograph]) -> Reconstruction:
    return reconstruct(posed[:6], CFG, 1.0, SOURCE)


@pytest.fixture(scope="module")
def estimated(posed: list[Photograph]) -> Reconstruction:
    """Of one distorted lens; poses and intrinsics unknown; the third photograph held out."""
    photographs = [replace(p, image=distorted(p.image, p.camera), camera=None) for p in posed]
    photographs[HELD_OUT] = replace(photographs[HELD_OUT], held_out=True)
    return reconstruct(photographs, CFG, 1.0, SOURCE)


def distorted(image: np.ndarray, pinhole: Camera) -> np.ndarray:
    """A pinhole image with radial distortion."""
    matrix = np.array(
        [[pinhole.fx, 0, pinhole.cx - 0.5], [0, pinhole.fy, pinhole.cy - 0.5], [0, 0, 1]]
    )  # pixel centres
    pixels = np.indices(image.shape[:2])[::-1].reshape(2, -1).T.astype(float)
    source = cv2.undistortPoints(pixels[:, None], matrix, np.array([RADIAL, 0, 0, 0]), P=matrix)
    return cv2.remap(image, source.reshape(*image.shape[:2], 2).astype(np.float32), None, cv2.INTER_CUBIC)


def unposed(photographs: list[Photograph]) -> list[Photograph]:
    return [replace(p, camera=None) for p in photographs]


def project(points: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) world -> (N, 2) pixels, (N,) depths."""
    in_camera = points @ camera.world_to_cam[:3, :3].T + camera.world_to_cam[:3, 3]
    return in_camera[:, :2] / in_camera[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy], in_camera[:, 2]


def inside(pixels: np.ndarray, camera: Camera) -> np.ndarray:
    return ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(axis=1)


def distances_after_similarity(points: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(N,) residuals between point sets (N, 3) after the best similarity transform (Umeyama 1991), relative to the
    target's radius."""
    a, b = points - points.mean(axis=0), target - target.mean(axis=0)
    u, s, vt = np.linalg.svd(b.T @ a)
    sign = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    scale = np.trace(np.diag(s) @ sign) / (a**2).sum()
    radius = np.sqrt((b**2).sum(axis=1).max())
    return np.linalg.norm(scale * a @ (u @ sign @ vt).T - b, axis=1) / radius


def assert_equal_cameras(one: Reconstruction, other: Reconstruction) -> None:
    for name, found in one.cameras.items():
        np.testing.assert_array_equal(found.camera.world_to_cam, other.cameras[name].camera.world_to_cam)


# --- Poses unknown ----------------------------------------------------------------------------------------------------


def test_estimated_poses_match_ground_truth(estimated: Reconstruction, posed: list[Photograph]) -> None:
    """Also the pose of the held-out photograph."""
    assert estimated.poses == "estimated" and estimated.photographs == 10
    assert set(estimated.cameras) == {p.name for p in posed}
    ours = np.stack([estimated.cameras[p.name].camera.position for p in posed])
    truth = np.stack([p.camera.position for p in posed])
    # Relative to half the rig's width: features are accurate to a third of a pixel, which is 0.5 % at this focal length
    # and distance.
    assert distances_after_similarity(ours, truth).max() < 0.02


def test_estimated_intrinsics_match_ground_truth(estimated: Reconstruction, posed: list[Photograph]) -> None:
    """All cameras have the same distance to one point, so that focal length and depth are weakly determined: 2 %."""
    assert len(estimated.points) > 500 and estimated.errors.mean() < 0.5
    for found in estimated.cameras.values():
        assert found.camera.fx == pytest.approx(posed[0].camera.fx, rel=0.02)
        assert found.radial == pytest.approx(RADIAL, abs=0.02)


def test_held_out_photograph_does_not_affect_the_rest(posed: list[Photograph]) -> None:
    """The other results have the same bits without it. Names may have spaces."""
    photographs = [replace(p, name=f"# Camera {i} 50%") for i, p in enumerate(unposed(posed[:5]))]
    without = reconstruct([p for p in photographs if p != photographs[HELD_OUT]], FEW, 1.0, SOURCE)
    photographs[HELD_OUT] = replace(photographs[HELD_OUT], held_out=True)
    found = reconstruct(photographs, FEW, 1.0, SOURCE)
    np.testing.assert_array_equal(without.points, found.points)
    assert set(found.cameras) - set(without.cameras) == {photographs[HELD_OUT].name}
    assert_equal_cameras(without, found)


@pytest.mark.parametrize("name", ["frame_00012", "Camera 1", "# 50%", "a\tb\u00a0c", "Küche.v2", "%20"])
def test_names_of_files_for_colmap(name: str) -> None:
    file = image_file(name)
    assert photograph_name(file) == name and file.split() == [file] and file[0] != "#"
    assert file == f"{name}.png" or not name.replace("_", "").isalnum()


def test_result_is_deterministic(posed: list[Photograph]) -> None:
    first, second = (reconstruct(unposed(posed[:4]), FEW, 1.0, SOURCE) for _ in range(2))
    np.testing.assert_array_equal(first.points, second.points)
    assert_equal_cameras(first, second)


# --- Poses known ------------------------------------------------------------------------------------------------------


def test_known_poses_are_kept_and_points_have_pixel_colours(known: Reconstruction, posed: list[Photograph]) -> None:
    assert known.poses == "known" and len(known.points) > 300
    for photograph in posed[:6]:
        np.testing.assert_array_equal(
            known.cameras[photograph.name].camera.world_to_cam, photograph.camera.world_to_cam
        )
    assert known.errors.max() <= 2.0 and known.track_lengths.min() >= 3
    off = []
    for photograph in posed[:3]:
        pixels, _ = project(known.points, photograph.camera)
        kept = inside(pixels, photograph.camera)
        column, row = np.floor(pixels[kept]).astype(int).T
        off.append(np.abs(photograph.image[row, column].astype(int) - known.colors[kept]).mean(axis=1))
    # The median, because not all points are visible in all three. Colours are means over photographs: within 30 levels;
    # with permuted points the difference is 60.
    assert np.median(np.concatenate(off)) < 30


def test_points_lie_on_surfaces(known: Reconstruction, posed: list[Photograph], world: World) -> None:
    """Depths of points equal the traced depth, in the best of all cameras: points may be occluded in the others."""
    off = np.full(len(known.points), np.inf)
    for camera in (p.camera for p in posed[:6]):
        pixels, depths = project(known.points, camera)
        visible = np.flatnonzero((depths > 0) & inside(pixels, camera))
        column, row = pixels[visible].astype(int).T
        off[visible] = np.minimum(off[visible], np.abs(depths[visible] - depth_of(world, camera, 0.0)[row, column]))
    assert np.isfinite(off).all()
    assert np.median(off) < 0.01 * camera_extent([p.camera for p in posed])


def test_refined_poses_are_more_accurate_and_aligned(posed: list[Photograph]) -> None:
    rng = np.random.default_rng(0)
    moved = [replace(p, camera=perturbed(p.camera, 0.01, rng)) for p in posed[:6]]
    found = reconstruct(moved, replace(CFG, refine_poses=True), 1.0, SOURCE)
    assert found.poses == "refined"
    truth, before = (np.stack([p.camera.position for p in photographs]) for photographs in (posed[:6], moved))
    after = np.stack([found.cameras[p.name].camera.position for p in moved])

    def shape_error(places: np.ndarray) -> float:
        """Root mean square residual against the true positions, up to a similarity."""
        return float(np.sqrt(np.mean(distances_after_similarity(places, truth) ** 2)))

    assert shape_error(after) < 0.6 * shape_error(before)
    # Aligned to the given poses: their mean is the same.
    assert np.linalg.norm((after - before).mean(axis=0)) < 1e-6


def perturbed(camera: Camera, amount: float, rng: np.random.Generator) -> Camera:
    pose = camera.world_to_cam.copy()
    pose[:3, 3] += amount * rng.normal(size=3)
    return replace(camera, world_to_cam=pose)


# --- Errors -----------------------------------------------------------------------------------------------------------


def test_too_few_points_are_refused_with_advice(posed: list[Photograph]) -> None:
    with pytest.raises(
        ValueError, match=r"at least 1000000 points .*init.min_points.*found \d+; .*init.source=random"
    ) as e:
        reconstruct(posed[:3], replace(FEW, min_points=1_000_000), 1.0, SOURCE)
    assert "\n" not in str(e.value)


def test_photographs_without_overlap_are_refused_in_one_line() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (3, 96, 128, 3), dtype=np.uint8)
    photographs = [Photograph(f"cam{i}", image) for i, image in enumerate(noise)]
    with pytest.raises(ValueError, match="photographs: expected 3 photographs of the same objects") as error:
        reconstruct(photographs, CFG, 1.0, SOURCE)
    assert "\n" not in str(error.value)


def test_one_training_camera_is_refused(posed: list[Photograph]) -> None:
    with pytest.raises(ValueError, match="at least 2 training cameras.*found 1"):
        reconstruct([posed[0], replace(posed[1], held_out=True)], CFG, 1.0, SOURCE)


# --- Cache and command line -------------------------------------------------------------------------------------------


def test_cache_depends_on_inputs(posed: list[Photograph], tmp_path: Path) -> None:
    found, folder = reconstruct_cached(posed[:4], CFG, 1.0, SOURCE, tmp_path)
    made = {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    assert set(made) == {"result.npz", "result.json", "sfm.json", "sfm.png"}
    again, same = reconstruct_cached(posed[:4], CFG, 1.0, SOURCE, tmp_path)
    assert same == folder and {path.name: path.stat().st_mtime_ns for path in folder.iterdir()} == made
    np.testing.assert_array_equal(again.points, found.points)
    kept = load(folder)
    assert kept.summary() == found.summary()
    assert_equal_cameras(found, kept)

    before = fingerprint(posed, CFG, 1.0)
    other_image = [replace(posed[0], image=posed[0].image ^ 1), *posed[1:]]
    assert (
        len(
            {
                before,
                fingerprint(posed, replace(CFG, max_features=7), 1.0),
                fingerprint(posed, CFG, 2.0),
                fingerprint(posed[1:], CFG, 1.0),
                fingerprint(other_image, CFG, 1.0),
            }
        )
        == 5
    )
    assert fingerprint(posed, replace(CFG, min_points=5, sphere_points=5), 1.0) == before
    of_logs = replace(CFG, lidar_points=5, lidar_velocities=False)
    assert fingerprint(posed, of_logs, 1.0) == before


def test_a_cached_clip_with_too_few_points_is_refused(tmp_path: Path) -> None:
    """Nothing is reconstructed: the cache holds seven points for these photographs."""
    photographs = [Photograph(f"p{i}", np.full((4, 6, 3), i, np.uint8)) for i in range(2)]
    cached = tmp_path / f"sfm-{fingerprint(photographs, CFG, 1.0, CLIP_VERSION)}"
    points, colors, numbers = np.random.default_rng(0).random((7, 3)), np.zeros((7, 3), np.uint8), np.ones(7)
    lens = CalibratedCamera(Camera(6, 4, 5.0, 5.0, 3.0, 2.0, np.eye(4)), 0.0)
    save(Reconstruction(points, colors, numbers, numbers.astype(int), {"p0": lens}, "estimated", 2, 0.0), cached)
    found, folder = reconstruct_cached(photographs, replace(CFG, min_points=7), 1.0, SOURCE, tmp_path, clip_log=print)
    assert folder == cached and len(found.points) == 7
    with pytest.raises(ValueError, match=r"at least 8 points \(init.min_points\), found 7"):
        reconstruct_cached(photographs, replace(CFG, min_points=8), 1.0, SOURCE, tmp_path, clip_log=print)


def test_command_line(posed: list[Photograph], tmp_path: Path, capsys) -> None:
    """On PNG and JPEG files of doubled size, read at half the size."""
    folder = tmp_path / "photographs"
    folder.mkdir()
    for i, photograph in enumerate(posed):
        doubled = Image.fromarray(photograph.image.repeat(2, axis=0).repeat(2, axis=1))
        doubled.save(folder / f"{photograph.name}.{('png', 'jpg', 'JPEG')[i % 3]}", quality=95)
    for i, (photograph, original) in enumerate(zip(read_photographs(folder, downscale=2), posed, strict=True)):
        assert (photograph.name, photograph.camera) == (original.name, None)
        difference = np.abs(photograph.image.astype(int) - original.image)
        assert difference.max() == 0 if i % 3 == 0 else difference.mean() < 2  # levels; JPEG is lossy
    assert main([str(folder), "--downscale", "2", "--max-features", "600", "--out", str(tmp_path / "out")]) == 0
    assert "11 of 11 photographs" in capsys.readouterr().out
    assert (tmp_path / "out" / "sfm.png").stat().st_size > 10_000
    assert main([str(tmp_path)]) == 1
    assert "expected photographs" in capsys.readouterr().err
