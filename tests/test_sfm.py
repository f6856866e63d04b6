"""Structure from motion: points on the surfaces, poses where they are, the same result for a seed, faults in a line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.config import InitConfig
from pipeline.sfm.__main__ import main, read_photographs
from pipeline.sfm.photograph import Lens, Photograph, Reconstruction
from pipeline.sfm.run import reconstruct
from pipeline.sfm.store import fingerprint, load, reconstruct_once
from rasterizer import Camera

CASTLE = Path(__file__).parents[2] / "shared" / "data" / "sceaux_castle" / "images"
CASTLE_FOCAL = 2905.88  # pixels of the whole photograph, 2832 wide; from the K.txt beside the images
DOWNSCALE = 6  # 472 pixels wide: a second a photograph
FEW = InitConfig(max_features=1500)
SOURCE = Path("photographs")


@pytest.fixture(scope="module")
def castle() -> list[Photograph]:
    return read_photographs(CASTLE, downscale=DOWNSCALE)


@pytest.fixture(scope="module")
def estimated(castle: list[Photograph]) -> Reconstruction:
    """The castle with its third photograph held out."""
    return reconstruct([replace(p, held_out=i == 2) for i, p in enumerate(castle)], FEW, 1.0, SOURCE)


@pytest.fixture(scope="module")
def posed(castle: list[Photograph], estimated: Reconstruction) -> list[Photograph]:
    """Half of the castle's photographs as a pinhole would have taken them, with the poses that were found for them."""
    return [undistorted(p, estimated.lenses[p.name]) for p in castle[4:9]]


def undistorted(photograph: Photograph, lens: Lens) -> Photograph:
    c = lens.camera
    pinhole = np.array([[c.fx, 0, c.cx - 0.5], [0, c.fy, c.cy - 0.5], [0, 0, 1]])  # OpenCV counts from pixel centres
    image = cv2.undistort(photograph.image, pinhole, np.array([lens.radial, 0, 0, 0]))
    return replace(photograph, image=image, camera=c)


def project(points: np.ndarray, camera: Camera) -> np.ndarray:
    """(N, 3) world -> (N, 2) pixels."""
    seen = points @ camera.world_to_cam[:3, :3].T + camera.world_to_cam[:3, 3]
    return seen[:, :2] / seen[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]


def test_photographs_of_a_building_find_their_places(estimated: Reconstruction) -> None:
    assert len(estimated.lenses) == 11 and estimated.photographs == 10 and estimated.poses == "estimated"
    assert estimated.errors.mean() < 0.8
    assert len(estimated.points) > 500
    # The lens was never told: its focal length agrees with the photographer's own calibration.
    for lens in estimated.lenses.values():
        assert lens.camera.fx == pytest.approx(CASTLE_FOCAL / DOWNSCALE, rel=0.03)


def test_a_held_out_photograph_has_no_part_in_the_points(castle: list[Photograph], estimated: Reconstruction) -> None:
    """Without it everything else comes out the same, to the last bit; and with it in, it stands at the same place."""
    without = reconstruct([p for i, p in enumerate(castle) if i != 2], FEW, 1.0, SOURCE)
    np.testing.assert_array_equal(without.points, estimated.points)
    for name, lens in without.lenses.items():
        np.testing.assert_array_equal(lens.camera.world_to_cam, estimated.lenses[name].camera.world_to_cam)


def test_a_held_out_photograph_is_placed_where_its_neighbours_say(castle, estimated: Reconstruction) -> None:
    """The photographer walked along the building: the third photograph is between the second and the fourth."""
    second, third, fourth = (estimated.lenses[castle[i].name].camera.position for i in (1, 2, 3))
    along = fourth - second
    assert 0.2 < (third - second) @ along / (along @ along) < 0.8
    beside = np.linalg.norm(np.cross(third - second, along)) / (along @ along)
    assert beside < 0.4


def test_known_poses_are_kept_and_give_points_that_project_onto_the_features(posed: list[Photograph]) -> None:
    found = reconstruct(posed, FEW, 1.0, SOURCE)
    assert found.poses == "known" and len(found.points) > 500
    for photograph in posed:
        np.testing.assert_array_equal(found.lenses[photograph.name].camera.world_to_cam, photograph.camera.world_to_cam)
    assert found.errors.max() <= FEW.max_error_px and found.track_lengths.min() >= FEW.min_track
    # Independent of COLMAP's own reckoning: a point's colour is that of the pixels it falls on.
    hits = []
    for photograph in posed[:3]:
        pixels = np.floor(project(found.points, photograph.camera)).astype(int)
        inside = ((pixels >= 0) & (pixels < photograph.image.shape[1::-1])).all(axis=1)
        there = photograph.image[pixels[inside, 1], pixels[inside, 0]].astype(int)
        hits.append(np.abs(there - found.colors[inside]).mean(axis=1))
    # Not all points are seen in all three, and colours are means over photographs: half of them within 30 levels,
    # where colours of points in another order are 60 off.
    assert np.median(np.concatenate(hits)) < 30


def test_the_result_is_a_function_of_the_seed(castle: list[Photograph]) -> None:
    few, cfg = castle[:4], InitConfig(max_features=800, min_points=10)
    first, second = (reconstruct(few, cfg, 1.0, SOURCE) for _ in range(2))
    np.testing.assert_array_equal(first.points, second.points)
    for name in first.lenses:
        np.testing.assert_array_equal(first.lenses[name].camera.world_to_cam, second.lenses[name].camera.world_to_cam)


def test_too_few_points_end_with_advice(posed: list[Photograph]) -> None:
    with pytest.raises(ValueError, match=r"at least 1000000 points .*init.min_points.*found \d+; .*init.max_error_px") as e:
        reconstruct(posed[:3], replace(FEW, min_points=1_000_000), 1.0, SOURCE)
    assert "\n" not in str(e.value)


def test_photographs_of_nothing_in_common_end_in_one_line() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (3, 96, 128, 3), dtype=np.uint8)
    photographs = [Photograph(f"cam{i}", image) for i, image in enumerate(noise)]
    with pytest.raises(ValueError, match="photographs: expected 3 photographs that show the same things") as error:
        reconstruct(photographs, FEW, 1.0, SOURCE)
    assert "\n" not in str(error.value)


def test_one_training_camera_is_not_enough(castle: list[Photograph]) -> None:
    with pytest.raises(ValueError, match="at least 2 training cameras.*found 1"):
        reconstruct([castle[0], replace(castle[1], held_out=True)], FEW, 1.0, SOURCE)


def test_a_result_is_kept_until_what_it_follows_from_changes(posed: list[Photograph], tmp_path: Path) -> None:
    found, folder = reconstruct_once(posed[:4], FEW, 1.0, SOURCE, tmp_path)
    made = {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    assert set(made) == {"result.npz", "result.json", "sfm.json", "sfm.png"}
    again, same = reconstruct_once(posed[:4], FEW, 1.0, SOURCE, tmp_path)
    assert same == folder and {path.name: path.stat().st_mtime_ns for path in folder.iterdir()} == made
    np.testing.assert_array_equal(again.points, found.points)
    kept = load(folder)
    assert kept.summary() == found.summary()
    for name, lens in found.lenses.items():
        np.testing.assert_array_equal(kept.lenses[name].camera.world_to_cam, lens.camera.world_to_cam)

    before = fingerprint(posed, FEW, 1.0)
    other_image = [replace(posed[0], image=posed[0].image ^ 1), *posed[1:]]
    assert len({before, fingerprint(posed, replace(FEW, seed=1), 1.0), fingerprint(posed, FEW, 2.0),
                fingerprint(posed[1:], FEW, 1.0), fingerprint(other_image, FEW, 1.0)}) == 5
    assert fingerprint(posed, replace(FEW, min_points=5, sphere_points=5), 1.0) == before


def test_the_command_says_what_it_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(CASTLE), "--downscale", "8", "--max-features", "1000", "--out", str(tmp_path / "out")]) == 0
    assert "11 of 11 photographs" in capsys.readouterr().out
    assert (tmp_path / "out" / "sfm.png").stat().st_size > 10_000
    assert main([str(tmp_path)]) == 1
    assert "expected photographs" in capsys.readouterr().err
