"""Structure from motion on photographs that the tracer makes: cameras, lens and surfaces are known to the last digit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from datasets.scene import camera_extent
from datasets.synthetic.film import depth_of, film
from datasets.synthetic.world import World
from datasets.synthetic.write_film import Shooting
from pipeline.config.schema import InitConfig
from pipeline.data.sfm.__main__ import main, read_photographs
from pipeline.data.sfm.photograph import Photograph, Reconstruction
from pipeline.data.sfm.run import reconstruct
from pipeline.data.sfm.store import fingerprint, load, reconstruct_once
from rasterizer import Camera

# Eleven cameras before a counter with many textured things on it.
SHOOTING = Shooting(scene="counter", seed=1, size=320, cameras=11, frames=1, samples=3)
RADIAL = 0.1  # of the lens x → x (1 + RADIAL |x|²): 5 % at a photograph's corner, 10 pixels
CFG = InitConfig(max_features=1000)
FEW = InitConfig(max_features=800, min_points=10)
SOURCE = Path("photographs")
HELD_OUT = 2


@pytest.fixture(scope="module")
def world() -> World:
    return SHOOTING.set_up()[0]


@pytest.fixture(scope="module")
def posed(world: World) -> list[Photograph]:
    """By pinhole cameras whose poses are told."""
    return [
        Photograph(f"p{i:02d}", next(film(world, camera, SHOOTING.times, samples=SHOOTING.samples)), camera)
        for i, camera in enumerate(SHOOTING.set_up()[1])
    ]


@pytest.fixture(scope="module")
def known(posed: list[Photograph]) -> Reconstruction:
    return reconstruct(posed[:6], CFG, 1.0, SOURCE)


@pytest.fixture(scope="module")
def estimated(posed: list[Photograph]) -> Reconstruction:
    """All by one lens that is not a pinhole, nothing told of it nor of the poses, the third one held out."""
    photographs = [replace(p, image=through_lens(p.image, p.camera), camera=None) for p in posed]
    photographs[HELD_OUT] = replace(photographs[HELD_OUT], held_out=True)
    return reconstruct(photographs, CFG, 1.0, SOURCE)


def through_lens(image: np.ndarray, pinhole: Camera) -> np.ndarray:
    """What a pinhole took, as the lens would have taken it."""
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
    seen = points @ camera.world_to_cam[:3, :3].T + camera.world_to_cam[:3, 3]
    return seen[:, :2] / seen[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy], seen[:, 2]


def inside(pixels: np.ndarray, camera: Camera) -> np.ndarray:
    return ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(axis=1)


def distances_after_similarity(points: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(N,) what is left between point sets (N, 3) after the best rotation, scale and shift (Umeyama 1991), relative to
    the target's spread."""
    a, b = points - points.mean(axis=0), target - target.mean(axis=0)
    u, s, vt = np.linalg.svd(b.T @ a)
    sign = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    scale = np.trace(np.diag(s) @ sign) / (a**2).sum()
    spread = np.sqrt((b**2).sum(axis=1).max())
    return np.linalg.norm(scale * a @ (u @ sign @ vt).T - b, axis=1) / spread


def assert_same_lenses(one: Reconstruction, other: Reconstruction) -> None:
    for name, lens in one.lenses.items():
        np.testing.assert_array_equal(lens.camera.world_to_cam, other.lenses[name].camera.world_to_cam)


# ---- Poses unknown -----------------------------------------------------------------------------------------


def test_all_photographs_find_their_places(estimated: Reconstruction, posed: list[Photograph]) -> None:
    """The held-out one too: it stands where it stood in truth, as the others do."""
    assert estimated.poses == "estimated" and estimated.photographs == 10
    assert set(estimated.lenses) == {p.name for p in posed}
    ours = np.stack([estimated.lenses[p.name].camera.position for p in posed])
    truth = np.stack([p.camera.position for p in posed])
    # Of the rig's half width: a feature is found to a third of a pixel, which is half a per cent at this focal length
    # and distance; a pose is the mean over hundreds.
    assert distances_after_similarity(ours, truth).max() < 0.02


def test_the_lens_is_found(estimated: Reconstruction, posed: list[Photograph]) -> None:
    """All cameras look at one place from much the same distance, so focal length and depth can be traded: 2 %."""
    assert len(estimated.points) > 500 and estimated.errors.mean() < 0.5
    for lens in estimated.lenses.values():
        assert lens.camera.fx == pytest.approx(posed[0].camera.fx, rel=0.02)
        assert lens.radial == pytest.approx(RADIAL, abs=0.02)


def test_a_held_out_photograph_has_no_part_in_the_points(posed: list[Photograph]) -> None:
    """Without it everything else comes out the same, to the last bit."""
    photographs = unposed(posed[:5])
    without = reconstruct([p for p in photographs if p != photographs[HELD_OUT]], FEW, 1.0, SOURCE)
    photographs[HELD_OUT] = replace(photographs[HELD_OUT], held_out=True)
    found = reconstruct(photographs, FEW, 1.0, SOURCE)
    np.testing.assert_array_equal(without.points, found.points)
    assert set(found.lenses) - set(without.lenses) == {posed[HELD_OUT].name}
    assert_same_lenses(without, found)


def test_the_result_is_a_function_of_the_seed(posed: list[Photograph]) -> None:
    first, second = (reconstruct(unposed(posed[:4]), FEW, 1.0, SOURCE) for _ in range(2))
    np.testing.assert_array_equal(first.points, second.points)
    assert_same_lenses(first, second)


# ---- Poses known -------------------------------------------------------------------------------------------


def test_known_poses_are_kept_and_points_have_the_colour_of_the_pixels_they_fall_on(
    known: Reconstruction, posed: list[Photograph]
) -> None:
    assert known.poses == "known" and len(known.points) > 300
    for photograph in posed[:6]:
        np.testing.assert_array_equal(known.lenses[photograph.name].camera.world_to_cam, photograph.camera.world_to_cam)
    assert known.errors.max() <= CFG.max_error_px and known.track_lengths.min() >= CFG.min_track
    off = []
    for photograph in posed[:3]:
        pixels, _ = project(known.points, photograph.camera)
        kept = inside(pixels, photograph.camera)
        column, row = np.floor(pixels[kept]).astype(int).T
        off.append(np.abs(photograph.image[row, column].astype(int) - known.colors[kept]).mean(axis=1))
    # Not all points are seen in all three, and colours are means over photographs: half of them within 30 levels,
    # where colours of points in another order are 60 off.
    assert np.median(np.concatenate(off)) < 30


def test_points_lie_on_the_surfaces(known: Reconstruction, posed: list[Photograph], world: World) -> None:
    """Each point lies beside a surface: its depth in a camera that sees it is the tracer's there.

    A point behind something is not seen by that camera, so of all cameras the best one counts.
    """
    off = np.full(len(known.points), np.inf)
    for camera in (p.camera for p in posed[:6]):
        pixels, depths = project(known.points, camera)
        seen = np.flatnonzero((depths > 0) & inside(pixels, camera))
        column, row = pixels[seen].astype(int).T
        off[seen] = np.minimum(off[seen], np.abs(depths[seen] - depth_of(world, camera, 0.0)[row, column]))
    assert np.isfinite(off).all()
    assert np.median(off) < 0.01 * camera_extent([p.camera for p in posed])


def test_refined_poses_come_nearer_to_the_truth_and_stay_in_its_frame(posed: list[Photograph]) -> None:
    rng = np.random.default_rng(0)
    moved = [replace(p, camera=shaken(p.camera, 0.01, rng)) for p in posed[:6]]
    found = reconstruct(moved, replace(CFG, refine_poses=True, max_error_px=4.0), 1.0, SOURCE)
    assert found.poses == "refined"
    truth, before = (np.stack([p.camera.position for p in photographs]) for photographs in (posed[:6], moved))
    after = np.stack([found.lenses[p.name].camera.position for p in moved])

    def bend(places: np.ndarray) -> float:
        """Against the true places: what shaking changes and no choice of frame does."""
        return float(np.sqrt(np.mean(distances_after_similarity(places, truth) ** 2)))

    assert bend(after) < 0.6 * bend(before)
    # The frame is that of the poses given: their middle is where it was.
    assert np.linalg.norm((after - before).mean(axis=0)) < 1e-6


def shaken(camera: Camera, amount: float, rng: np.random.Generator) -> Camera:
    pose = camera.world_to_cam.copy()
    pose[:3, 3] += amount * rng.normal(size=3)
    return replace(camera, world_to_cam=pose)


# ---- Faults ------------------------------------------------------------------------------------------------


def test_too_few_points_end_with_advice(posed: list[Photograph]) -> None:
    with pytest.raises(
        ValueError, match=r"at least 1000000 points .*init.min_points.*found \d+; .*init.max_error_px"
    ) as e:
        reconstruct(posed[:3], replace(FEW, min_points=1_000_000), 1.0, SOURCE)
    assert "\n" not in str(e.value)


def test_photographs_of_nothing_in_common_end_in_one_line() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (3, 96, 128, 3), dtype=np.uint8)
    photographs = [Photograph(f"cam{i}", image) for i, image in enumerate(noise)]
    with pytest.raises(ValueError, match="photographs: expected 3 photographs that show the same things") as error:
        reconstruct(photographs, CFG, 1.0, SOURCE)
    assert "\n" not in str(error.value)


def test_one_training_camera_is_not_enough(posed: list[Photograph]) -> None:
    with pytest.raises(ValueError, match="at least 2 training cameras.*found 1"):
        reconstruct([posed[0], replace(posed[1], held_out=True)], CFG, 1.0, SOURCE)


# ---- What is kept, and the command -------------------------------------------------------------------------


def test_a_result_is_kept_until_what_it_follows_from_changes(posed: list[Photograph], tmp_path: Path) -> None:
    found, folder = reconstruct_once(posed[:4], CFG, 1.0, SOURCE, tmp_path)
    made = {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    assert set(made) == {"result.npz", "result.json", "sfm.json", "sfm.png"}
    again, same = reconstruct_once(posed[:4], CFG, 1.0, SOURCE, tmp_path)
    assert same == folder and {path.name: path.stat().st_mtime_ns for path in folder.iterdir()} == made
    np.testing.assert_array_equal(again.points, found.points)
    kept = load(folder)
    assert kept.summary() == found.summary()
    assert_same_lenses(found, kept)

    before = fingerprint(posed, CFG, 1.0)
    other_image = [replace(posed[0], image=posed[0].image ^ 1), *posed[1:]]
    assert (
        len(
            {
                before,
                fingerprint(posed, replace(CFG, seed=1), 1.0),
                fingerprint(posed, CFG, 2.0),
                fingerprint(posed[1:], CFG, 1.0),
                fingerprint(other_image, CFG, 1.0),
            }
        )
        == 5
    )
    assert fingerprint(posed, replace(CFG, min_points=5, sphere_points=5), 1.0) == before


def test_the_command_says_what_it_found(posed: list[Photograph], tmp_path: Path, capsys) -> None:
    """In a folder of PNG and JPEG files, each pixel doubled, and so read at half the size."""
    folder = tmp_path / "photographs"
    folder.mkdir()
    for i, photograph in enumerate(posed):
        doubled = Image.fromarray(photograph.image.repeat(2, axis=0).repeat(2, axis=1))
        doubled.save(folder / f"{photograph.name}.{('png', 'jpg', 'JPEG')[i % 3]}", quality=95)
    for i, (photograph, original) in enumerate(zip(read_photographs(folder, downscale=2), posed, strict=True)):
        assert (photograph.name, photograph.camera) == (original.name, None)
        difference = np.abs(photograph.image.astype(int) - original.image)
        assert difference.max() == 0 if i % 3 == 0 else difference.mean() < 2  # levels; JPEG loses some
    assert main([str(folder), "--downscale", "2", "--max-features", "600", "--out", str(tmp_path / "out")]) == 0
    assert "11 of 11 photographs" in capsys.readouterr().out
    assert (tmp_path / "out" / "sfm.png").stat().st_size > 10_000
    assert main([str(tmp_path)]) == 1
    assert "expected photographs" in capsys.readouterr().err
