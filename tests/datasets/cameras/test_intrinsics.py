"""Intrinsics of transforms files: every key of converters is used, or the file is refused."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import cv2
import dnerf_folder
import numpy as np
import pytest
from dnerf_folder import blender_pose
from PIL import Image

from datasets.cameras.intrinsics import merge_intrinsics, read_distortion
from datasets.cameras.lens import FisheyeLens, Undistortion
from datasets.files.errors import SceneError

WIDTH, HEIGHT = 64, 48
FX, FY, CX, CY = 70.0, 72.0, 30.0, 26.0
LENS = {"k1": -0.4, "k2": 0.05, "p1": 0.01, "p2": -0.005}
LISTED = [LENS["k1"], LENS["k2"], 0.0, 0.0, LENS["p1"], LENS["p2"]]  # in nerfstudio's order


def write(root: Path, intrinsics: dict, image: np.ndarray | None = None, **of_second_entry: float) -> Path:
    """Two splits of two opaque images."""
    image = np.full((HEIGHT, WIDTH, 3), 90, np.uint8) if image is None else image
    for split in ("train", "test"):
        (root / split).mkdir(parents=True, exist_ok=True)
        frames = [
            {"file_path": f"./{split}/r_{i}", "time": float(i), "transform_matrix": blender_pose(float(i))}
            for i in range(2)
        ]
        frames[1].update(of_second_entry)
        for i in range(2):
            Image.fromarray(image).save(root / split / f"r_{i}.png")
        (root / f"transforms_{split}.json").write_text(json.dumps({**intrinsics, "frames": frames}))
    return root


def read(root: Path, **options: object):
    return dnerf_folder.read(root, **{"downscale": 1, **options})


def test_pixel_intrinsics_override_the_centred_default(tmp_path: Path) -> None:
    angle = 2 * math.atan(WIDTH / (2 * FX))
    write(tmp_path, {"camera_angle_x": angle, "fl_x": FX, "fl_y": FY, "cx": CX, "cy": CY, "w": WIDTH, "h": HEIGHT})
    camera = read(tmp_path).train[0].camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (FX, FY, CX, CY)
    half = read(tmp_path, downscale=2).train[0].camera
    assert (half.fx, half.fy, half.cx, half.cy) == (FX / 2, FY / 2, CX / 2, CY / 2)


def test_projection_of_a_point(tmp_path: Path) -> None:
    write(tmp_path, {"fl_x": FX, "fl_y": FY, "cx": CX, "cy": CY})
    camera = read(tmp_path).test[1].camera  # at (1, 0, 4)
    x, y, z, _ = camera.world_to_cam @ [1.5, 0.25, 1.0, 1.0]  # offset 0.5 right, 0.25 up, 3 in front
    assert (camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy) == pytest.approx(
        (FX * 0.5 / 3 + CX, -FY * 0.25 / 3 + CY)
    )


def test_defaults_of_missing_keys(tmp_path: Path) -> None:
    write(tmp_path, {"camera_angle_x": 0.7, "camera_angle_y": 0.5, "cx": CX})
    camera = read(tmp_path).train[0].camera
    assert camera.fx == pytest.approx(0.5 * WIDTH / math.tan(0.35))
    assert camera.fy == pytest.approx(0.5 * HEIGHT / math.tan(0.25))
    assert (camera.cx, camera.cy) == (CX, HEIGHT / 2)
    write(tmp_path, {"fl_x": FX})
    camera = read(tmp_path).train[0].camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (FX, FX, WIDTH / 2, HEIGHT / 2)


def test_intrinsics_of_an_entry_override_the_files(tmp_path: Path) -> None:
    write(tmp_path, {"camera_angle_x": 0.7}, fl_x=FX, cy=CY)
    first, second = (view.camera for view in read(tmp_path).train)
    assert (first.fx, first.cy) == (pytest.approx(0.5 * WIDTH / math.tan(0.35)), HEIGHT / 2)
    assert (second.fx, second.cy) == (FX, CY)


def test_intrinsics_of_a_larger_image_are_scaled(tmp_path: Path) -> None:
    write(tmp_path, {"fl_x": 2 * FX, "fl_y": 2 * FY, "cx": 2 * CX, "cy": 2 * CY, "w": 2 * WIDTH, "h": 2 * HEIGHT})
    camera = read(tmp_path).train[0].camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (FX, FY, CX, CY)


def distorted_positions() -> np.ndarray:
    """(H, W, 2) position in the pinhole image of each pixel of the distorted image.

    Solves x_d = x (1 + k1 r² + k2 r⁴) + 2 p1 x y + p2 (r² + 2 x²), and likewise y_d, by fixed-point iteration.
    """
    columns, rows = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    xd, yd = (columns - CX) / FX, (rows - CY) / FY
    x, y = xd.copy(), yd.copy()
    for _ in range(100):
        r2 = x**2 + y**2
        radial = 1 + LENS["k1"] * r2 + LENS["k2"] * r2**2
        dx = 2 * LENS["p1"] * x * y + LENS["p2"] * (r2 + 2 * x**2)
        dy = LENS["p1"] * (r2 + 2 * y**2) + 2 * LENS["p2"] * x * y
        x, y = (xd - dx) / radial, (yd - dy) / radial
    return np.stack([x * FX + CX - 0.5, y * FY + CY - 0.5], axis=-1)


def gradient(positions: np.ndarray) -> np.ndarray:
    """An image (H, W, 3) of two ramps at pixel positions (H, W, 2): values encode positions."""
    values = np.stack([2 * positions[..., 0] + 50, 3 * positions[..., 1] + 50, np.full(positions.shape[:2], 128)], -1)
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("lens", [LENS, {"distortion_params": LISTED}, {"distortion_params": LISTED, "k1": 9.0}])
def test_distorted_image_is_undistorted(tmp_path: Path, lens: dict) -> None:
    """Of a list and keys in one place nerfstudio takes the list."""
    distorted = gradient(distorted_positions())
    write(tmp_path, {"fl_x": FX, "fl_y": FY, "cx": CX, "cy": CY, **lens, "camera_model": "OPENCV"}, distorted)
    undistorted = np.asarray(read(tmp_path).train[0].image).astype(float)
    columns, rows = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    truth = gradient(np.stack([columns, rows], axis=-1).astype(float)).astype(float)
    inner = np.s_[8:-8, 8:-8]  # outside, the undistorted image shows pixels beyond the original border
    # Two roundings to levels and OpenCV's 1/32 pixel: 0.5 + 0.5 + 3/32 levels.
    assert np.abs(undistorted - truth)[inner].max() <= 2
    assert np.abs(distorted.astype(float) - truth)[inner].max() > 4, "the distortion must be visible"


@pytest.mark.parametrize("downscale", [1, 2])
def test_what_the_lens_has_not_imaged_does_not_count(tmp_path: Path, downscale: int) -> None:
    """A pixel at radius r of the undistorted image is at r (1 + k1 r²) of the file, beyond its border near the edges.
    Positions have OpenCV's 1/32 of a pixel: what is nearer than that to the border is left out of the comparison."""
    k1 = 0.3
    write(tmp_path, {"fl_x": FX, "fl_y": FY, "cx": CX, "cy": CY, "k1": k1})
    columns, rows = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    x, y = (columns - CX) / FX, (rows - CY) / FY
    radial = 1 + k1 * (x**2 + y**2)
    at = x * radial * FX + CX, y * radial * FY + CY
    margin = np.minimum.reduce([at[0], WIDTH - at[0], at[1], HEIGHT - at[1]])  # pixels within the file's image
    blocks = margin.reshape(HEIGHT // downscale, downscale, WIDTH // downscale, downscale).min(axis=(1, 3))
    mask = read(tmp_path, downscale=downscale).train[0].mask
    sure = np.abs(blocks) > 1 / 16
    assert mask is not None and mask.dtype == bool and 0.05 < (~mask).mean() < 0.3
    np.testing.assert_array_equal(mask[sure], blocks[sure] > 0)
    write(tmp_path / "barrel", {"fl_x": FX, "fl_y": FY, "cx": CX, "cy": CY, "k1": -k1})
    assert read(tmp_path / "barrel").train[0].mask is None


@pytest.mark.parametrize(
    "lens, fold",
    [
        ({"k1": -1.5}, (1 / 4.5) ** 0.5),  # r (1 + k1 r²) ascends up to r² = -1 / (3 k1)
        ({"k1": 0.2, "k2": -3.0}, ((0.6 + (0.36 + 60) ** 0.5) / 30) ** 0.5),  # 1 + 3 k1 r² + 5 k2 r⁴ = 0
    ],
)
def test_pixels_beyond_the_fold_of_a_lens_do_not_count(tmp_path: Path, lens: dict, fold: float) -> None:
    """A pixel is RADII steps of the picture's radius of 0.7 wide at most: what is nearer to the fold is left out."""
    write(tmp_path, {"fl_x": FX, "fl_y": FY, "cx": CX, "cy": CY, **lens})
    columns, rows = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    radius = np.hypot((columns - CX) / FX, (rows - CY) / FY)
    lines: list[str] = []
    mask = read(tmp_path, log=lines.append).train[0].mask
    assert mask is not None and radius.max() > fold + 0.05
    sure = np.abs(radius - fold) > 1e-3
    np.testing.assert_array_equal(mask[sure], (radius < fold)[sure])
    (said,) = [line for line in lines if "turns back inside the image" in line]
    assert float(re.findall(r"image, ([\d.]+) focal lengths", said)[0]) == pytest.approx(fold, abs=1e-3)
    assert any(line.startswith(f"lens (k1 {lens['k1']:g}") for line in lines)


@pytest.mark.parametrize("tangential", [0.0, 0.4])
def test_a_fold_is_where_opencvs_own_derivative_changes_its_sign(tangential: float) -> None:
    """cv2.projectPoints along rays, by finite differences; fisheye lenses by their formula θ (1 + k1 θ²)."""
    lens = Undistortion(100.0, 100.0, 100.0, 80.0, (-0.8, 0.0, tangential, 0.0, 0.0))
    fold = lens.fold((200, 160))
    for index, angle in enumerate(2 * np.pi * np.arange(len(fold)) / len(fold)):
        radius = np.linspace(0, 1.28, 4000)
        ray = np.stack([np.cos(angle) * radius, np.sin(angle) * radius, np.ones_like(radius)], axis=1)
        bent = cv2.projectPoints(ray, np.zeros(3), np.zeros(3), np.eye(3), np.array(lens.coefficients))[0][:, 0]
        turned = np.diff(bent @ [np.cos(angle), np.sin(angle)]) <= 0
        expected = radius[turned.argmax()] if turned.any() else np.inf
        assert fold[index] == pytest.approx(expected, abs=1.28 / 2048 + 1.28 / 4000)
    theta = (1 / 1.2) ** 0.5  # 1 + 3 k1 θ² = 0
    fisheye = FisheyeLens(100.0, 100.0, 300.0, 300.0, (-0.4, 0.0, 0.0, 0.0)).fold((600, 600))
    np.testing.assert_allclose(fisheye, np.tan(theta), atol=4.3 / 2048)


def test_listed_distortion_is_in_nerfstudios_order() -> None:
    values = merge_intrinsics({"distortion_params": [1, 2, 3, 0, 5, 6]}, {}, "x")
    assert read_distortion(values, "x") == (1, 2, 5, 6, 3)  # OpenCV's: k1, k2, p1, p2, k3
    of_an_entry = merge_intrinsics({"distortion_params": [1, 2, 3, 0, 5, 6]}, {"k1": 7, "p2": 8}, "x")
    assert read_distortion(of_an_entry, "x") == (7, 2, 5, 8, 3)
    assert read_distortion(merge_intrinsics({"k1": 7}, {"distortion_params": [0] * 6}, "x"), "x") == (0, 0, 0, 0, 0)


def test_undistortion_ignores_colour_of_transparent_pixels(tmp_path: Path) -> None:
    rgba = np.zeros((HEIGHT, WIDTH, 4), np.uint8)
    rgba[..., 1] = 255  # green in transparent pixels
    rgba[12:36, 16:48] = (200, 0, 0, 255)
    write(tmp_path, {"fl_x": FX, "fl_y": FY, **LENS}, rgba)
    image = np.asarray(read(tmp_path).train[0].image)
    assert image[..., 1].max() <= 1 and image[24, 32].tolist() == [200, 0, 0]


@pytest.mark.parametrize(
    ("intrinsics", "message"),
    [
        ({"camera_angle_x": 0.7, "fl_x": 2 * FX}, r"fl_x: expected the focal length of camera_angle_x, 87\.6"),
        ({"fl_x": FX, "camera_model": "OPENCV_FISHEYE"}, "camera_model: expected PINHOLE, .* found 'OPENCV_FISHEYE'"),
        ({"fl_x": FX, "is_fisheye": True}, "camera_model: expected PINHOLE, .* found a fisheye"),
        ({"fl_x": FX, "k4": 0.1}, r"k4: expected 0: .* undistort the images first .* found 0\.1"),
        ({"fl_x": FX, "k1": "small"}, "k1: expected a number, found 'small'"),
        ({"fl_x": FX, "distortion_params": [0.1] * 4}, "distortion_params: .* k1, k2, k3, k4, p1, p2, found 4 values$"),
        ({"fl_x": FX, "distortion_params": 0.1}, "distortion_params: expected a list of .*, found float$"),
        ({"fl_x": FX, "distortion_params": [0, 0, None, 0, 0, 0]}, "k3: expected a number, found None$"),
        ({"fl_x": FX, "distortion_params": [0, 0, 0, 0.1, 0, 0]}, r"k4: expected 0: .* found 0\.1"),
        ({"fl_x": FX, "w": 100, "h": HEIGHT}, "expected w x h of 64 x 48 .* found 100 x 48"),
        ({"fl_x": -FX}, "fl_x and fl_y > 0, found -70"),
        ({"fl_y": FY}, "expected the key camera_angle_x, or fl_x, found only"),
    ],
)
def test_invalid_intrinsics_are_refused_in_one_line(tmp_path: Path, intrinsics: dict, message: str) -> None:
    with pytest.raises(SceneError, match=message) as caught:
        read(write(tmp_path, intrinsics))
    assert "\n" not in str(caught.value) and "transforms_train.json" in str(caught.value)
