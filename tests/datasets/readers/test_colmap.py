"""COLMAP's folder, written by its own library: lenses, the files' layout and cameras by folder."""

from __future__ import annotations

import re
import shutil
import struct
import unicodedata
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from layout_folders import COUNT, HEIGHT, WIDTH, picture, write_colmap
from layout_scenes import check, check_ramp, fisheye, read, row_15, write_ramp
from PIL import Image
from scipy.spatial.transform import Rotation

from datasets.files.errors import SceneError


@pytest.mark.parametrize("binary", [True, False])
def test_colmap(tmp_path: Path, binary: bool) -> None:
    scene, lines = read(write_colmap(tmp_path, binary))
    check(scene)
    assert "taken for COLMAP" in lines[0] and "not Dynamic 3D Gaussians (no train_meta.json)" in lines[0]
    assert any("times: the numbers in the file names" in line for line in lines)
    assert scene.test_split == "every 8th frame" and [view.name for view in scene.test] == ["test/frame_005"]
    assert scene.points is not None
    np.testing.assert_allclose(scene.points.positions, [[i, 2 * i, 0.5] for i in range(5)])
    assert scene.points.colors[:, 0].tolist() == [0, 10, 20, 30, 40]


@pytest.mark.parametrize(
    "model, bent",
    [("RADIAL", (0.05, -0.01)), ("OPENCV", (0.05, 0.0, 0.001, 0.0)), ("OPENCV_FISHEYE", (0.02, 0.0, 0.0, 0.0))],
)
def test_colmap_lenses_are_undistorted(tmp_path: Path, model: str, bent: tuple[float, ...]) -> None:
    """The ramp of the straight image follows from the model's formula."""
    root = write_colmap(tmp_path, True, model, bent)
    write_ramp(root / "images")
    x, y = row_15()
    r2 = x**2 + y**2
    source = x * (1 + bent[0] * r2 + (bent[1] * r2**2 if model == "RADIAL" else 0))
    source = source + (2 * bent[2] * x * y if model == "OPENCV" else 0)
    check_ramp(read(root)[0], fisheye(bent) if model == "OPENCV_FISHEYE" else source)


def test_of_several_models_the_largest_is_read(tmp_path: Path) -> None:
    """The mapper writes one for each part of the images that it could not join."""
    root = write_colmap(tmp_path, False)
    small = root / "sparse/small"
    shutil.copytree(root / "sparse/0", small)
    lines = [line for line in (small / "images.txt").read_text().split("\n") if not line.startswith("#")]
    (small / "images.txt").write_text("\n".join(lines[:8]) + "\n")
    (root / "sparse/0").rename(root / "sparse/1")
    small.rename(root / "sparse/0")
    scene, said = read(root)
    check(scene)
    assert any("2 models (0 has 4, 1 has 12 images); the largest is used" in line for line in said)


def test_backslashes_in_the_names_of_images(tmp_path: Path) -> None:
    root = write_colmap(tmp_path, False)
    (root / "images/left").mkdir()
    for path in list((root / "images").glob("*.png")):
        path.rename(root / "images/left" / path.name)
    text = (root / "sparse/0/images.txt").read_text()
    (root / "sparse/0/images.txt").write_text(text.replace("frame_", "left\\frame_"))
    check(read(root)[0])


@pytest.mark.parametrize(
    "lens",
    [
        "OPENCV_FISHEYE 40 30 50 50 20 15 0 0 0 0",
        "SIMPLE_RADIAL_FISHEYE 40 30 50 20 15 0",
        "RADIAL_FISHEYE 40 30 50 20 15 0 0",
        "SIMPLE_FISHEYE 40 30 50 20 15",
        "FISHEYE 40 30 50 50 20 15",
    ],
)
def test_fisheye_without_coefficients_is_equidistant(tmp_path: Path, lens: str) -> None:
    root = write_colmap(tmp_path, False)
    (root / "sparse/0/cameras.txt").write_text(f"1 {lens}\n")
    write_ramp(root / "images")
    check_ramp(read(root)[0], fisheye(()))


@pytest.mark.parametrize(
    "lens, formula",
    [  # factor of x, y by the squared distance from the axis in focal lengths, as in the papers of the models
        ("FOV 40 30 50 50 20 15 0.9", lambda r2: np.arctan(2 * np.sqrt(r2) * np.tan(0.45)) / 0.9 / np.sqrt(r2)),
        ("EUCM 40 30 50 50 20 15 0.6 1.1", lambda r2: 1 / (0.6 * np.sqrt(1.1 * r2 + 1) + 0.4)),
        ("SIMPLE_DIVISION 40 30 50 20 15 -0.3", lambda r2: 2 / (1 + np.sqrt(1 + 4 * 0.3 * r2))),
        ("DIVISION 40 30 50 50 20 15 -0.3", lambda r2: 2 / (1 + np.sqrt(1 + 4 * 0.3 * r2))),
    ],
)
def test_lenses_that_only_colmap_has(tmp_path: Path, lens: str, formula: Callable[[np.ndarray], np.ndarray]) -> None:
    root = write_colmap(tmp_path, False)
    (root / "sparse/0/cameras.txt").write_text(f"1 {lens}\n")
    write_ramp(root / "images")
    x, y = row_15()
    check_ramp(read(root)[0], x * formula(x**2 + y**2))


@pytest.mark.parametrize(
    "lens, line",
    [
        ("EQUIRECTANGULAR 40 30 40 30", "expected a lens model among .*, found EQUIRECTANGULAR; cut panoramas"),
        ("TOMORROWS 40 30 50 50 20 15", "expected a lens model among .*, found TOMORROWS; a newer pycolmap"),
        ("SIMPLE_FISHEYE 40 30 50 50 20 15", "expected SIMPLE_FISHEYE with 3 parameters, f, cx, cy, found 4"),
        ("PINHOLE 40 30 -nan(ind) 50 20 15", "expected valid camera parameters"),
    ],
)
def test_a_lens_that_cannot_be_is_refused_by_name_unless_no_image_uses_it(tmp_path: Path, lens: str, line: str) -> None:
    root = write_colmap(tmp_path, False)
    file = root / "sparse/0/cameras.txt"
    good = file.read_text()
    file.write_text(f"1 {lens}\n")
    with pytest.raises(SceneError, match=line):
        read(root)
    file.write_text(good + f"2 {lens}\n3 {lens}\n")
    scene, said = read(root)
    check(scene)
    assert "cameras.txt: left out, as no image is by them: camera 2, camera 3" in said


def test_a_lens_model_of_another_number(tmp_path: Path) -> None:
    file = write_colmap(tmp_path, True) / "sparse/0/cameras.bin"
    content = bytearray(file.read_bytes())
    content[12:16] = struct.pack("<i", 99)  # after the count and the camera's number
    file.write_bytes(content)
    with pytest.raises(SceneError, match=r"cameras\.bin: camera 1: expected lens models 0 to \d+, .*, found 99"):
        read(tmp_path)


def test_names_in_another_form_or_case(tmp_path: Path) -> None:
    """macOS decomposes letters, Windows ignores case; the file that is there is taken, and that is said."""
    root = write_colmap(tmp_path, False)
    text = (root / "sparse/0/images.txt").read_text().replace("frame_", "Küche_")
    (root / "sparse/0/images.txt").write_text(unicodedata.normalize("NFC", text), encoding="utf-8")
    for path in list((root / "images").iterdir()):
        path.rename(root / "images" / unicodedata.normalize("NFD", path.name.replace("frame_", "KÜCHE_")))
    (root / "images").rename(root / "input")
    scene, said = read(root)
    check(scene)
    assert any(
        line.startswith("images.txt: 12 names differ from the files' in Unicode's form or case") for line in said
    )
    shutil.copy(next((root / "input").glob("*_007.png")), root / "input/küche_007.png")
    with pytest.raises(SceneError, match=r"expected one file of this name in .*, found .* and .*, which differ in"):
        read(root)


def test_a_photograph_is_known_by_its_path(tmp_path: Path) -> None:
    """images/a/b.png and images/a_b.png are two."""
    root = write_colmap(tmp_path, False)
    (root / "images/a").mkdir()
    (root / "images/frame_003.png").rename(root / "images/a/frame_003.png")
    (root / "images/frame_004.png").rename(root / "images/a_frame_003.png")
    text = (root / "sparse/0/images.txt").read_text().replace("frame_003", "a/frame_003")
    (root / "sparse/0/images.txt").write_text(text.replace("frame_004", "a_frame_003"))
    scene, _ = read(root)
    assert {np.asarray(view.image).tobytes() for view in scene.train + scene.test} == {
        picture(i).tobytes() for i in range(COUNT)
    }
    (root / "sparse/0/images.txt").write_text(text.replace("frame_004", "frame_005"))
    with pytest.raises(SceneError, match=r"expected each photograph once, found .*frame_005\.png 2 times"):
        read(root)


def test_images_beside_the_model_come_first(tmp_path: Path) -> None:
    """colmap image_undistorter writes dense/images, while images/ has the distorted ones of the same names."""
    write_colmap(tmp_path, True)
    (tmp_path / "dense").mkdir()
    (tmp_path / "sparse/0").rename(tmp_path / "dense/sparse")
    shutil.copytree(tmp_path / "images", tmp_path / "dense/images")
    for path in (tmp_path / "images").iterdir():
        Image.new("RGB", (WIDTH, HEIGHT)).save(path)
    check(read(tmp_path)[0])
    shutil.rmtree(tmp_path / "images")
    check(read(tmp_path)[0])


@pytest.mark.parametrize("binary", [True, False])
def test_a_missing_image_is_said_with_the_file_that_names_it(tmp_path: Path, binary: bool) -> None:
    root = write_colmap(tmp_path, binary)
    (root / "images/frame_004.png").unlink()
    file = re.escape(str(root / "sparse/0" / ("images.bin" if binary else "images.txt")))
    with pytest.raises(SceneError, match=rf"frame_004\.png: expected the image that {file} names, found no such file$"):
        read(root)


def entries_of_images(root: Path) -> list[str]:
    lines = (root / "sparse/0/images.txt").read_text().splitlines()
    return [line for line in lines if line.strip() and not line.startswith("#")]


@pytest.mark.parametrize("between", ["", "# an image", "\n\n  # an image\n"])
@pytest.mark.parametrize("points", ["", "1.5 2.5 -1 3.5 4.5 -1"])
def test_blank_lines_and_comments_between_entries_of_images(tmp_path: Path, between: str, points: str) -> None:
    """Only the line after an entry is its points, which may be none."""
    root = write_colmap(tmp_path, False)
    content = "".join(f"{between}\n{entry}\n{points}\n" for entry in entries_of_images(root))
    (root / "sparse/0/images.txt").write_text(content)
    check(read(root)[0])


@pytest.mark.parametrize("points", ["", "1.5 2.5 -1 3.5 4.5 -1 5.5 6.5 2 7.5 8.5 1 9.5 10.5 3\n"])
def test_images_without_a_line_of_points(tmp_path: Path, points: str) -> None:
    """As scripts write them: one line an image, or two only where there are points. A name may have blanks."""
    root = write_colmap(tmp_path, False)
    entries = [entry.replace("frame_", "2024 my frame_") for entry in entries_of_images(root)]
    for path in list((root / "images").iterdir()):
        path.rename(path.with_name(f"2024 my {path.name}"))
    content = "".join(f"{entry}\n{points if index % 3 else ''}" for index, entry in enumerate(entries))
    (root / "sparse/0/images.txt").write_text(content)
    check(read(root)[0])


def test_a_text_file_that_was_cut_is_refused(tmp_path: Path) -> None:
    """Its head, which COLMAP writes, counts what it had."""
    file = write_colmap(tmp_path, False) / "sparse/0/images.txt"
    lines = file.read_text().splitlines()
    file.write_text("\n".join(lines[: len(lines) // 2]) + "\n")
    with pytest.raises(SceneError, match=r"images\.txt: expected 12 entries, as its comment says .*, found [45]$"):
        read(tmp_path)


@pytest.mark.parametrize("scale", [1, 100])
def test_the_bound_of_reprojection_errors_grows_with_the_images(tmp_path: Path, scale: int) -> None:
    """2 pixels, and a thousandth of the longer side where that is more: 4 of 4000."""
    root = write_colmap(tmp_path, False)
    camera = f"1 PINHOLE {40 * scale} {30 * scale} {50 * scale} {50 * scale} {20 * scale} {15 * scale}\n"
    (root / "sparse/0/cameras.txt").write_text(camera)
    errors = (-1, 0.5, 1.9, 3.9, 4.1)
    rows = "".join(f"{i} {i} 2 3 9 8 7 {error} 1 1\n" for i, error in enumerate(errors))
    (root / "sparse/0/points3D.txt").write_text(rows)
    scene, lines = read(root)
    bound = 2 if scale == 1 else 4
    assert scene.points is not None and len(scene.points.positions) == sum(error <= bound for error in errors)
    left_out = sum(error > bound for error in errors)
    assert f"points: {left_out} of 5 have a reprojection error above {bound} px: left out" in lines


def filmed(root: Path, folders: tuple[str, ...]) -> Path:
    """Frames by cameras in turn, each with a folder of images."""
    write_colmap(root, False)
    lines = []
    for entry in entries_of_images(root):
        *values, name = entry.split()
        number = int(name[6:9]) - 1  # pycolmap writes in an order of its own
        moved = f"{folders[number % len(folders)]}/{number // len(folders):04d}.png"
        (root / "images" / moved).parent.mkdir(exist_ok=True)
        (root / "images" / name).rename(root / "images" / moved)
        lines.append((number, " ".join([*values, moved]) + "\n\n"))
    (root / "sparse/0/images.txt").write_text("".join(line for _, line in sorted(lines)))
    return root


@pytest.mark.parametrize(
    "folders, settings, held_out",
    [
        (("camC", "camA", "camB"), {}, "camera 0 (camA)"),
        (("camC", "camA", "camB"), {"test_cameras": [2, 1]}, "camera 1 (camB), 2 (camC)"),
        (("cam10", "cam9", "cam2"), {}, "camera 0 (cam2)"),
        (("right", "left"), {"test_cameras": [1]}, "camera 1 (right)"),
    ],
)
def test_cameras_are_numbered_by_their_folders(
    tmp_path: Path, folders: tuple[str, ...], settings: dict, held_out: str
) -> None:
    scene, lines = read(filmed(tmp_path, folders), **settings)
    assert scene.test_split == held_out and f"held out: {held_out}" in lines
    shown = {np.asarray(view.image).tobytes() for view in scene.test}
    assert shown == {picture(i).tobytes() for i in range(COUNT) if f"({folders[i % len(folders)]})" in held_out}


def test_two_cameras_are_held_out_only_on_request(tmp_path: Path) -> None:
    assert read(filmed(tmp_path, ("right", "left")))[0].test_split == "every 8th frame"
    with pytest.raises(SceneError, match=r"expected some of the cameras 0 \(left\), 1 \(right\), found \[7\]$"):
        read(tmp_path, test_cameras=[7])


@pytest.mark.parametrize("size", [0, 3, 20, 200])
def test_damaged_colmap_files_end_in_one_line(tmp_path: Path, size: int) -> None:
    root = write_colmap(tmp_path, True)
    file = root / "sparse/0/images.bin"
    file.write_bytes(file.read_bytes()[:size])
    with pytest.raises(SceneError) as error:
        read(root)
    assert "\n" not in str(error.value) and "images.bin" in str(error.value)


def test_a_rotation_is_colmaps() -> None:
    from datasets.readers.colmap import rotation_of

    quaternion = np.array([0.3, -0.5, 0.7, 0.2])
    expected = Rotation.from_quat(quaternion[[1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(rotation_of(quaternion, "x"), expected, atol=1e-12)


def test_a_byte_order_mark_and_spaces_at_the_ends_of_lines(tmp_path: Path) -> None:
    """As editors of Windows save the files."""
    folder = write_colmap(tmp_path, False) / "sparse/0"
    for name in ("cameras.txt", "images.txt", "points3D.txt"):
        lines = (folder / name).read_text().splitlines()
        (folder / name).write_text("\ufeff" + "".join(f"{line} \r\n" for line in lines), encoding="utf-8", newline="")
    scene, _ = read(tmp_path)
    assert len(scene.train) + len(scene.test) == COUNT
