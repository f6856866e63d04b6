"""Folders of other tools: each is written from the same cameras, by its own tool or as it describes its format."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from layout_folders import (
    HEIGHT,
    WIDTH,
    cameras,
    picture,
    write_dynamic_gaussians,
    write_llff,
    write_nerfies,
    write_nerfstudio,
)
from layout_scenes import check, read
from PIL import Image

from datasets.files.errors import SceneError


@pytest.mark.parametrize(
    "settings, expected",
    [
        ({"first_frame": 11}, r"scene\.first_frame: expected .* at least 3 of 12 .*, found 11, which leaves 1$"),
        ({"first_frame": 20, "frames": 2}, r"scene\.first_frame: .*, found 20, which leaves 0$"),
        ({"frames": 2}, r"scene\.frames: expected .* at least 3 of 12 .*, found 2, which leaves 2$"),
    ],
)
def test_settings_that_leave_too_few_photographs_are_named(tmp_path: Path, settings: dict, expected: str) -> None:
    with pytest.raises(SceneError, match=expected):
        read(write_llff(tmp_path), **settings)


def test_alpha_of_folders_is_kept(tmp_path: Path) -> None:
    write_nerfstudio(tmp_path)
    alpha = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH), np.uint8)
    path = tmp_path / "images/frame_00002.png"
    Image.fromarray(np.dstack([picture(1), alpha])).save(path)
    scene, _ = read(tmp_path, background="white")
    covered = {view.name: view.coverage for view in scene.train if view.coverage is not None}
    assert list(covered) == ["train/frame_00002"] and (covered["train/frame_00002"] == alpha).all()
    image = next(np.asarray(view.image) for view in scene.train if view.coverage is not None)
    share = alpha[..., None] / 255
    np.testing.assert_allclose(image, picture(1) * share + 255 * (1 - share), atol=0.501)  # rounded once
    assert scene.background == (1.0, 1.0, 1.0) and read(tmp_path)[0].background == (0.0, 0.0, 0.0)


def test_background_of_opaque_folders_is_their_border_colour(tmp_path: Path) -> None:
    write_nerfstudio(tmp_path)
    assert read(tmp_path)[0].background == (0.0, 0.0, 0.0)  # random pictures
    for path in (tmp_path / "images").iterdir():
        image = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
        image[10:20, 10:20] = 60
        Image.fromarray(image).save(path)
    scene, lines = read(tmp_path)
    assert scene.background == (1.0, 1.0, 1.0) and any(line.startswith("scene.background: white") for line in lines)
    assert read(tmp_path, background="black")[0].background == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("mirrored", [False, True])
def test_dynamic_gaussians(tmp_path: Path, mirrored: bool) -> None:
    """Some calibrations are of a mirrored world, which is mirrored back with its points."""
    scene, lines = read(write_dynamic_gaussians(tmp_path, mirrored))
    assert any("all poses are reflections" in line for line in lines) == mirrored
    assert "taken for Dynamic 3D Gaussians" in lines[0] and scene.test_split == "camera 1"
    assert len(scene.test) == 4 and len(scene.train) == 8 and scene.duration == 3
    for view in scene.train + scene.test:
        number = int(view.name.split("cam")[1][:2]) - 1
        np.testing.assert_allclose(view.camera.world_to_cam, cameras()[number].world_to_cam, atol=1e-9)
        assert (np.asarray(view.image) == picture(number)).all()
    assert scene.points is not None and scene.points.positions[0].tolist() == [1, 2, 3]
    assert scene.points.colors[0].tolist() == [128, 0, 255]


def test_dynamic_gaussians_without_some_images(tmp_path: Path) -> None:
    write_dynamic_gaussians(tmp_path, mirrored=False)
    images = sorted(path for path in (tmp_path / "ims").rglob("*") if path.is_file())
    images[0].unlink()
    scene, lines = read(tmp_path)
    assert len(scene.test) + len(scene.train) == len(images) - 1
    assert any("images; left out: 1 that are not there" in line and str(images[0]) in line for line in lines)


def test_nerfies(tmp_path: Path) -> None:
    scene, lines = read(write_nerfies(tmp_path))
    check(scene)
    assert "taken for Nerfies, HyperNeRF or DyCheck" in lines[0]
    assert [view.time for view in scene.train] == [3.0 * i for i in range(9)]
    assert [view.name for view in scene.test] == ["test/0_00009", "test/0_00010", "test/0_00011"]
    masks = [view.mask for view in scene.test]
    assert masks[0] is not None and masks[0][:10].all() and not masks[0][10:].any() and masks[1] is None


def nerfies_with(sizes: dict[int, tuple[int, int]], root: Path) -> Path:
    """Images of these sizes (width, height) in rgb/<factor>x and nowhere else, red by the factor; no masks."""
    names = [path.name for path in (root / "rgb/2x").iterdir()]
    shutil.rmtree(root / "rgb")
    shutil.rmtree(root / "covisible")
    for factor, size in sizes.items():
        (root / f"rgb/{factor}x").mkdir(parents=True)
        for name in names:
            Image.new("RGB", size, (factor, 0, 0)).save(root / f"rgb/{factor}x" / name)
    return root


@pytest.mark.parametrize(
    "folders, downscale, expected",
    [  # factor of the folder, of the image in use; the full images are 80 x 60 pixels
        ((1, 2, 4), 4, (4, 4)),
        ((1, 2, 4), 3, (1, 3)),
        ((1, 2), 4, (2, 4)),
        ((2, 8), 4, (2, 4)),
        ((2,), 3, (2, 4)),
        ((4,), 2, (4, 4)),
    ],
)
def test_nerfies_obeys_downscale(
    tmp_path: Path, folders: tuple[int, ...], downscale: int, expected: tuple[int, int]
) -> None:
    root = nerfies_with({factor: (80 // factor, 60 // factor) for factor in folders}, write_nerfies(tmp_path))
    camera, image = (view := read(root, downscale=downscale)[0].train[0]).camera, np.asarray(view.image)
    factor, reduction = expected
    assert image.shape == (60 // reduction, 80 // reduction, 3) and (image == [factor, 0, 0]).all()
    assert (camera.width, camera.fx) == (80 // reduction, pytest.approx(100 / reduction, rel=0.02))


@pytest.mark.parametrize("folders, side", [((2,), 1400), ((1, 2, 4), 1921), ((2, 4), 1281)])
def test_nerfies_chooses_640_pixels_at_most(tmp_path: Path, folders: tuple[int, ...], side: int) -> None:
    """side: pixels of the first folder."""
    sizes = {factor: (side * folders[0] // factor, 16) for factor in folders}
    root = nerfies_with(sizes, write_nerfies(tmp_path, 4))
    assert 400 < read(root)[0].train[0].camera.width <= 640


def test_llff(tmp_path: Path) -> None:
    scene, lines = read(write_llff(tmp_path))
    check(scene)
    assert "taken for NVIDIA Dynamic Scenes" in lines[0] and scene.test_split == "every 8th frame"


def test_what_is_no_layout_is_refused_with_every_reason(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("x")
    with pytest.raises(SceneError) as error:
        read(tmp_path)
    for reason in (
        "no train_meta.json",
        "no dataset.json",
        "no transforms.json",
        "no sparse/0",
        "no videos and no images",
    ):
        assert reason in str(error.value)


def test_images_without_poses_one_folder_down_are_named(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    Image.fromarray(picture(0)).save(tmp_path / "images/0.png")
    with pytest.raises(SceneError, match=f"scene.path={tmp_path}/images takes its images for one clip"):
        read(tmp_path)
