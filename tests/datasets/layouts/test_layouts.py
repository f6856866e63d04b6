"""Folders of other tools: each is written from the same cameras, by its own tool or as it describes its format."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from datasets import load_scene, with_reader
from datasets.files.errors import SceneError
from datasets.scene import Scene
from datasets.settings import SceneConfig
from datasets.synthetic.camera_path import look_at_origin
from rasterizer.camera import Camera

WIDTH, HEIGHT, COUNT = 40, 30, 12
BLENDER = np.diag([1.0, -1.0, -1.0, 1.0])


def cameras() -> list[Camera]:
    """COUNT places on an arc."""
    found = []
    for angle in np.linspace(-0.6, 0.6, COUNT):
        position = np.array([3 * np.sin(angle), -3 * np.cos(angle), 0.8])
        found.append(Camera(WIDTH, HEIGHT, 50.0, 50.0, 20.0, 15.0, look_at_origin(position)))
    return found


def picture(index: int) -> np.ndarray:
    return np.random.default_rng(index).integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)


def write_images(folder: Path, names: list[str]) -> None:
    for index, name in enumerate(names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(picture(index)).save(folder / name)


def read(path: Path, **settings: object) -> tuple[Scene, list[str]]:
    lines: list[str] = []
    cfg = SceneConfig(name="x", reader="auto", path=str(path), downscale=0)
    cfg = replace(with_reader(cfg, lines.append), **settings)  # type: ignore[arg-type]
    return load_scene(cfg, log=lines.append), lines


def check(scene: Scene, order: list[int] | None = None) -> None:
    """Cameras and pixels are those written; by time, `order` of the COUNT places."""
    views = sorted(scene.train + scene.test, key=lambda view: view.time)
    for view, index in zip(views, order or range(COUNT), strict=True):
        expected = cameras()[index]
        np.testing.assert_allclose(view.camera.world_to_cam, expected.world_to_cam, atol=1e-6)
        found = [getattr(view.camera, name) for name in ("fx", "fy", "cx", "cy")]
        np.testing.assert_allclose(found, [50, 50, 20, 15], rtol=1e-9)
        assert (np.asarray(view.image) == picture(index)).all()


# COLMAP's own library writes the files, in a process of its own: it must not share one with Pillow.
WRITE_COLMAP = """
import json, sys, numpy as np, pycolmap
folder, binary, model, parameters, poses = json.loads(sys.argv[1])
made = pycolmap.Reconstruction()
camera = pycolmap.Camera(model=model, width=40, height=30, params=parameters, camera_id=1)
made.add_camera_with_trivial_rig(camera)
for i, pose in enumerate(poses):
    image = pycolmap.Image(name=f"frame_{i + 1:03d}.png", camera_id=1, image_id=i + 1)
    made.add_image_with_trivial_frame(image, pycolmap.Rigid3d(np.array(pose)[:3]))
for i in range(5):
    track = pycolmap.Track()
    made.add_point3D(np.array([i, 2.0 * i, 0.5]), track, np.array([10 * i, 20, 30], np.uint8))
(made.write_binary if binary else made.write_text)(folder)
"""


def colmap_folder(root: Path, binary: bool, model: str = "PINHOLE", bent: tuple[float, ...] = ()) -> Path:
    (root / "sparse/0").mkdir(parents=True)
    write_images(root / "images", [f"frame_{i + 1:03d}.png" for i in range(COUNT)])
    one_focal = model.startswith("SIMPLE") or model == "RADIAL"
    lens = [50, 20, 15, *bent] if one_focal else [50, 50, 20, 15, *bent]
    request = [str(root / "sparse/0"), binary, model, lens, [c.world_to_cam.tolist() for c in cameras()]]
    subprocess.run([sys.executable, "-c", WRITE_COLMAP, json.dumps(request)], check=True)
    return root


@pytest.mark.parametrize("binary", [True, False])
def test_colmap(tmp_path: Path, binary: bool) -> None:
    scene, lines = read(colmap_folder(tmp_path, binary))
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
    """A ramp of grey along x seen through the lens: the ramp of the straight image follows from the model's formula."""
    root = colmap_folder(tmp_path, True, model, bent)
    ramp = np.repeat(np.broadcast_to(np.arange(WIDTH)[None, :, None] * 6, (HEIGHT, WIDTH, 1)), 3, axis=2)
    for path in (root / "images").iterdir():
        Image.fromarray(ramp.astype(np.uint8)).save(path)
    scene, _ = read(root)
    image = np.asarray(scene.train[0].image)[..., 0].astype(float)
    x, y = (np.arange(WIDTH) + 0.5 - 20) / 50, (15.5 - 15) / 50
    r2 = x**2 + y**2
    if model == "OPENCV_FISHEYE":
        theta = np.arctan(np.sqrt(r2))
        source = x * theta * (1 + bent[0] * theta**2) / np.sqrt(r2)
    else:
        source = x * (1 + bent[0] * r2 + (bent[1] * r2**2 if model == "RADIAL" else 0))
        source = source + (2 * bent[2] * x * y if model == "OPENCV" else 0)
    expected = 6 * (50 * source + 20 - 0.5)
    inside = (expected > 2) & (expected < 6 * (WIDTH - 2))
    np.testing.assert_allclose(image[15, inside], expected[inside], atol=1.0)  # 8 bits, and 1/32 pixel of OpenCV's maps


def test_colmap_lens_without_a_formula_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="found FOV; colmap image_undistorter"):
        read(colmap_folder(tmp_path, True, "FOV", (0.5,)))


def nerfstudio_folder(root: Path, **shared: object) -> Path:
    """transforms.json as ns-process-data writes it, with a mask for each frame whose left half does not count."""
    write_images(root / "images", [f"frame_{i + 1:05d}.png" for i in range(COUNT)])
    half = np.zeros((HEIGHT, WIDTH), np.uint8)
    half[:, WIDTH // 2 :] = 255
    frames = []
    for i, camera in enumerate(cameras()):
        pose = np.linalg.inv(camera.world_to_cam) @ BLENDER
        name = f"frame_{i + 1:05d}.png"
        (root / "masks").mkdir(exist_ok=True)
        Image.fromarray(half).save(root / "masks" / name)
        own = {"fl_x": 50.0, "fl_y": 50.0, "cx": 20.0, "cy": 15.0, "w": WIDTH, "h": HEIGHT}
        frames.append(
            {"file_path": f"images/{name}", "mask_path": f"masks/{name}", "transform_matrix": pose.tolist(), **own}
        )
    header = "ply\nformat ascii 1.0\nelement vertex 2\n" + "".join(f"property float {a}\n" for a in "xyz")
    header += "".join(f"property uchar {c}\n" for c in ("red", "green", "blue")) + "end_header\n"
    (root / "sparse_pc.ply").write_text(header + "1 2 3 10 20 30\n4 5 6 40 50 60\n")
    content = {"camera_model": "OPENCV", "ply_file_path": "sparse_pc.ply", **shared, "frames": frames}
    (root / "transforms.json").write_text(json.dumps(content))
    return root


def test_nerfstudio(tmp_path: Path) -> None:
    scene, lines = read(nerfstudio_folder(tmp_path))
    check(scene)
    assert "taken for nerfstudio" in lines[0]
    assert scene.points is not None and scene.points.positions.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert all(view.mask is not None and view.mask.sum() == WIDTH * HEIGHT // 2 for view in scene.train)


def test_nerfstudio_splits_and_missing_masks(tmp_path: Path) -> None:
    scene, _ = read(nerfstudio_folder(tmp_path, val_filenames=["images/frame_00003.png"]))
    assert [view.name for view in scene.test] == ["test/frame_00003"] and scene.test_split == "the layout's test frames"
    (tmp_path / "masks/frame_00002.png").unlink()
    with pytest.raises(SceneError, match="expected the mask of frame_00002, found no such file"):
        read(tmp_path)


def dynamic_gaussians_folder(root: Path, mirrored: bool) -> Path:
    """Three cameras at four times."""
    flip = np.diag([-1.0 if mirrored else 1.0, 1, 1, 1])
    content: dict = {"w": WIDTH, "h": HEIGHT, "k": [], "w2c": [], "fn": [], "cam_id": []}
    for t in range(4):
        names = [f"{c + 1}/{t:05d}.png" for c in range(3)]
        for c, name in enumerate(names):
            (root / "ims" / name).parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(picture(c)).save(root / "ims" / name)
        content["k"].append([[[50.0, 0, 20.0], [0, 50.0, 15.0], [0, 0, 1]]] * 3)
        content["w2c"].append([(cameras()[c].world_to_cam @ flip).tolist() for c in range(3)])
        content["fn"].append(names)
        content["cam_id"].append([1, 2, 3])
    (root / "train_meta.json").write_text(json.dumps(content))
    points = np.array([[1.0, 2, 3, 0.5, 0, 1, 1], [-1.0, 0, 1, 0, 0, 0, 0]])
    np.savez(root / "init_pt_cld.npz", data=points @ np.diag([*np.diag(flip)[:3], 1, 1, 1, 1]))
    return root


@pytest.mark.parametrize("mirrored", [False, True])
def test_dynamic_gaussians(tmp_path: Path, mirrored: bool) -> None:
    """Some calibrations are of a mirrored world, which is mirrored back with its points."""
    scene, lines = read(dynamic_gaussians_folder(tmp_path, mirrored))
    assert "taken for Dynamic 3D Gaussians" in lines[0] and scene.test_split == "camera 1"
    assert len(scene.test) == 4 and len(scene.train) == 8 and scene.duration == 3
    for view in scene.train + scene.test:
        number = int(view.name.split("cam")[1][:2]) - 1
        np.testing.assert_allclose(view.camera.world_to_cam, cameras()[number].world_to_cam, atol=1e-9)
        assert (np.asarray(view.image) == picture(number)).all()
    assert scene.points is not None and scene.points.positions[0].tolist() == [1, 2, 3]
    assert scene.points.colors[0].tolist() == [128, 0, 255]


def nerfies_folder(root: Path) -> Path:
    ids = [f"0_{i:05d}" for i in range(COUNT)]
    write_images(root / "rgb/2x", [f"{name}.png" for name in ids])
    (root / "camera").mkdir()
    for name, camera in zip(ids, cameras()):
        content = {
            "orientation": camera.world_to_cam[:3, :3].tolist(), "position": camera.position.tolist(),
            "focal_length": 100.0, "principal_point": [40.0, 30.0], "skew": 0.0, "pixel_aspect_ratio": 1.0,
            "radial_distortion": [0.0, 0.0, 0.0], "tangential_distortion": [0.0, 0.0],
            "image_size": [2 * WIDTH, 2 * HEIGHT],
        }  # fmt: skip
        (root / "camera" / f"{name}.json").write_text(json.dumps(content))
    metadata = {name: {"warp_id": 3 * i, "appearance_id": i, "camera_id": 0} for i, name in enumerate(ids)}
    (root / "metadata.json").write_text(json.dumps(metadata))
    split = {"ids": ids, "train_ids": ids[:9], "val_ids": ids[9:], "count": COUNT, "num_exemplars": 9}
    (root / "dataset.json").write_text(json.dumps(split))
    np.save(root / "points.npy", np.array([[0.0, 1.0, 2.0]]))
    covisible = root / "covisible/2x/val"
    covisible.mkdir(parents=True)
    seen = np.zeros((HEIGHT, WIDTH), np.uint8)
    seen[:10] = 255
    Image.fromarray(seen).save(covisible / f"{ids[9]}.png")
    return root


def test_nerfies(tmp_path: Path) -> None:
    scene, lines = read(nerfies_folder(tmp_path))
    check(scene)
    assert "taken for Nerfies, HyperNeRF or DyCheck" in lines[0]
    assert [view.time for view in scene.train] == [3.0 * i for i in range(9)]
    assert [view.name for view in scene.test] == ["test/0_00009", "test/0_00010", "test/0_00011"]
    masks = [view.mask for view in scene.test]
    assert masks[0] is not None and masks[0][:10].all() and not masks[0][10:].any() and masks[1] is None


def test_llff(tmp_path: Path) -> None:
    write_images(tmp_path / "images", [f"{i:03d}.png" for i in range(COUNT)])
    rows = []
    for camera in cameras():
        right, down, forward = camera.world_to_cam[:3, :3]
        block = np.stack([down, right, -forward, camera.position, [HEIGHT, WIDTH, 50.0]], axis=1)
        rows.append(np.concatenate([block.ravel(), [1.0, 10.0]]))
    np.save(tmp_path / "poses_bounds.npy", np.array(rows))
    scene, lines = read(tmp_path)
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


@pytest.mark.parametrize("size", [0, 3, 20, 200])
def test_damaged_colmap_files_end_in_one_line(tmp_path: Path, size: int) -> None:
    root = colmap_folder(tmp_path, True)
    file = root / "sparse/0/images.bin"
    file.write_bytes(file.read_bytes()[:size])
    with pytest.raises(SceneError) as error:
        read(root)
    assert "\n" not in str(error.value) and "images.bin" in str(error.value)


def test_a_rotation_is_colmaps() -> None:
    from datasets.layouts.colmap import rotation_of

    quaternion = np.array([0.3, -0.5, 0.7, 0.2])
    expected = Rotation.from_quat(quaternion[[1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(rotation_of(quaternion, "x"), expected, atol=1e-12)
