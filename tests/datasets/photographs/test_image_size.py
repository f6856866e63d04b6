"""Images of other sizes than their cameras', and of different sizes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from layout_folders import HEIGHT, WIDTH, picture, write_colmap, write_nerfies, write_nerfstudio
from layout_scenes import read
from PIL import Image

from datasets.files.errors import SceneError
from datasets.scene import Scene


def lens_of_each(root: Path, lenses: list[str]) -> None:
    """In text: image i has the lens i % len(lenses), which is `MODEL WIDTH HEIGHT PARAMETERS`."""
    (root / "sparse/0/cameras.txt").write_text("".join(f"{i + 1} {lens}\n" for i, lens in enumerate(lenses)))
    path = root / "sparse/0/images.txt"
    lines = [line for line in path.read_text().split("\n") if not line.startswith("#")]
    for i, row in enumerate(range(0, len(lines) - 1, 2)):
        *pose, _, name = lines[row].split()
        lines[row] = " ".join([*pose, str(1 + i % len(lenses)), name])
    path.write_text("\n".join(lines))


def by_name(scene: Scene) -> dict:
    return {view.name.rpartition("/")[2]: view for view in (*scene.train, *scene.test)}


def test_images_of_nearly_one_size_lose_their_right_and_lower_border(tmp_path: Path) -> None:
    """As colmap image_undistorter writes them where each image has a lens of its own. Principal points stay."""
    root = write_colmap(tmp_path, False)
    lens_of_each(root, ["PINHOLE 40 30 50 50 20 15", "PINHOLE 38 29 48 48 19.5 14"])
    for i in range(1, 12, 2):
        Image.fromarray(picture(i)[:29, :38]).save(root / f"images/frame_{i + 1:03d}.png")
    scene, lines = read(root)
    assert "images of different sizes are cut at the right and below, to 38 x 29" in lines
    for i, view in enumerate(by_name(scene)[f"frame_{i + 1:03d}"] for i in range(12)):
        assert (view.camera.width, view.camera.height) == (38, 29)
        found = (view.camera.fx, view.camera.cx, view.camera.cy)
        assert found == ((48, 19.5, 14) if i % 2 else (50, 20, 15))
        assert (np.asarray(view.image) == picture(i)[:29, :38]).all()


def test_images_of_quite_different_sizes_are_refused(tmp_path: Path) -> None:
    root = write_colmap(tmp_path, False)
    lens_of_each(root, ["PINHOLE 40 30 50 50 20 15", "PINHOLE 30 40 50 50 15 20"])
    for i in range(1, 12, 2):
        Image.fromarray(np.rot90(picture(i)).copy()).save(root / f"images/frame_{i + 1:03d}.png")
    with pytest.raises(
        SceneError, match="about 30 x 40 pixels as frame_002.png; scale all images to one size, found 40"
    ):
        read(root)


@pytest.mark.parametrize("lens", ["PINHOLE 80 61 100 100 40 30.5", "OPENCV 80 61 100 100 40 30.5 0 0 0 0"])
def test_a_camera_is_scaled_to_its_image(tmp_path: Path, lens: str) -> None:
    """The model is of images of twice the size; half of 61 rows is 30."""
    root = write_colmap(tmp_path, False)
    lens_of_each(root, [lens])
    view = by_name(read(root)[0])["frame_001"]
    assert (view.camera.width, view.camera.height) == (WIDTH, HEIGHT)
    np.testing.assert_allclose([view.camera.fx, view.camera.cx], [50, 20])
    np.testing.assert_allclose([view.camera.fy, view.camera.cy], np.array([100, 30.5]) * 30 / 61)


def test_a_distorted_lens_is_scaled_with_its_camera(tmp_path: Path) -> None:
    """The same lens, of images of one and of twice the resolution, undistorts the same images alike."""
    images = {}
    for name, lens in (("one", "50 50 20 15"), ("twice", "100 100 40 30")):
        root = write_colmap(tmp_path / name, False)
        size = "40 30" if name == "one" else "80 60"
        lens_of_each(root, [f"OPENCV {size} {lens} 0.05 -0.01 0.001 0.002"])
        images[name] = np.asarray(by_name(read(root)[0])["frame_001"].image)
    assert (images["one"] == images["twice"]).all() and (images["one"] != picture(0)).any()


def test_an_image_of_another_shape_than_its_camera_is_refused(tmp_path: Path) -> None:
    root = write_colmap(tmp_path, False)
    lens_of_each(root, ["PINHOLE 40 40 50 50 20 20"])
    with pytest.raises(SceneError, match="expected 40 x 40 pixels, as its camera, or of that shape, found 40 x 30"):
        read(root)


def test_images_of_nerfstudio_may_have_sizes_of_their_own(tmp_path: Path) -> None:
    """Their masks are cut alike."""
    root = write_nerfstudio(tmp_path)
    content = json.loads((root / "transforms.json").read_text())
    content["frames"][3] |= {"w": 38, "h": 29}
    Image.fromarray(picture(3)[:29, :38]).save(root / "images/frame_00004.png")
    Image.fromarray(np.full((29, 38), 255, np.uint8)).save(root / "masks/frame_00004.png")
    (root / "transforms.json").write_text(json.dumps(content))
    views = by_name(read(root)[0])
    assert all(view.mask.shape == (29, 38) == np.asarray(view.image).shape[:2] for view in views.values())
    assert views["frame_00004"].mask.all() and not views["frame_00001"].mask[:, :20].any()
    assert views["frame_00001"].mask[:, 20:].all()


def test_masks_of_another_resolution_are_scaled(tmp_path: Path) -> None:
    """DyCheck's are of images of half the size."""
    root = write_nerfies(tmp_path)
    (root / "rgb/1x").mkdir()
    for i, path in enumerate(sorted((root / "rgb/2x").iterdir())):
        Image.fromarray(np.kron(picture(i), np.ones((2, 2, 1), np.uint8))).save(root / "rgb/1x" / path.name)
    masked = [view for view in read(root, downscale=1)[0].test if view.mask is not None]
    assert len(masked) == 1 and masked[0].mask is not None
    assert masked[0].mask.shape == (2 * HEIGHT, 2 * WIDTH)
    assert masked[0].mask[:20].all() and not masked[0].mask[20:].any()
