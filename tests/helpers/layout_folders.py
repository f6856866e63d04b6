"""Writes small folders in the layouts of other tools, all of the same cameras and pictures."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from pipeline.evaluation.pictures.camera_path import look_at
from rasterizer.camera import Camera

WIDTH, HEIGHT, COUNT = 40, 30, 12
BLENDER = np.diag([1.0, -1.0, -1.0, 1.0])


def cameras(count: int = COUNT) -> list[Camera]:
    """`count` places on an arc."""
    found = []
    for angle in np.linspace(-0.6, 0.6, count):
        position = np.array([3 * np.sin(angle), -3 * np.cos(angle), 0.8])
        pose = look_at(position, np.zeros(3), np.array([0.0, 0.0, -1.0]))
        found.append(Camera(WIDTH, HEIGHT, 50.0, 50.0, 20.0, 15.0, pose))
    return found


def picture(index: int) -> np.ndarray:
    return np.random.default_rng(index).integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)


def write_images(folder: Path, names: list[str]) -> None:
    for index, name in enumerate(names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(picture(index)).save(folder / name)


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


def write_colmap(
    root: Path, binary: bool, model: str = "PINHOLE", bent: tuple[float, ...] = (), count: int = COUNT
) -> Path:
    (root / "sparse/0").mkdir(parents=True)
    write_images(root / "images", [f"frame_{i + 1:03d}.png" for i in range(count)])
    one_focal = model.startswith("SIMPLE") or model == "RADIAL"
    lens = [50, 20, 15, *bent] if one_focal else [50, 50, 20, 15, *bent]
    request = [str(root / "sparse/0"), binary, model, lens, [c.world_to_cam.tolist() for c in cameras(count)]]
    subprocess.run([sys.executable, "-c", WRITE_COLMAP, json.dumps(request)], check=True)
    return root


def write_nerfstudio(root: Path, count: int = COUNT, **shared: object) -> Path:
    """transforms.json as ns-process-data writes it, with a mask for each frame whose left half does not count."""
    write_images(root / "images", [f"frame_{i + 1:05d}.png" for i in range(count)])
    half = np.zeros((HEIGHT, WIDTH), np.uint8)
    half[:, WIDTH // 2 :] = 255
    frames = []
    for i, camera in enumerate(cameras(count)):
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


def write_dynamic_gaussians(root: Path, mirrored: bool = False, times: int = 4) -> Path:
    """Three cameras at `times` times."""
    flip = np.diag([-1.0 if mirrored else 1.0, 1, 1, 1])
    content: dict = {"w": WIDTH, "h": HEIGHT, "k": [], "w2c": [], "fn": [], "cam_id": []}
    for t in range(times):
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


def write_nerfies(root: Path, count: int = COUNT) -> Path:
    """The last quarter is held out; the first frame of it has a mask, whose upper third counts."""
    ids = [f"0_{i:05d}" for i in range(count)]
    write_images(root / "rgb/2x", [f"{name}.png" for name in ids])
    (root / "camera").mkdir()
    for name, camera in zip(ids, cameras(count)):
        content = {
            "orientation": camera.world_to_cam[:3, :3].tolist(), "position": camera.position.tolist(),
            "focal_length": 100.0, "principal_point": [40.0, 30.0], "skew": 0.0, "pixel_aspect_ratio": 1.0,
            "radial_distortion": [0.0, 0.0, 0.0], "tangential_distortion": [0.0, 0.0],
            "image_size": [2 * WIDTH, 2 * HEIGHT],
        }  # fmt: skip
        (root / "camera" / f"{name}.json").write_text(json.dumps(content))
    metadata = {name: {"warp_id": 3 * i, "appearance_id": i, "camera_id": 0} for i, name in enumerate(ids)}
    (root / "metadata.json").write_text(json.dumps(metadata))
    kept = count - count // 4
    split = {"ids": ids, "train_ids": ids[:kept], "val_ids": ids[kept:], "count": count, "num_exemplars": kept}
    (root / "dataset.json").write_text(json.dumps(split))
    np.save(root / "points.npy", np.array([[0.0, 1.0, 2.0]]))
    covisible = root / "covisible/2x/val"
    covisible.mkdir(parents=True)
    seen = np.zeros((HEIGHT, WIDTH), np.uint8)
    seen[:10] = 255
    Image.fromarray(seen).save(covisible / f"{ids[kept]}.png")
    return root


def write_llff(root: Path, count: int = COUNT) -> Path:
    write_images(root / "images", [f"{i:03d}.png" for i in range(count)])
    rows = []
    for camera in cameras(count):
        right, down, forward = camera.world_to_cam[:3, :3]
        block = np.stack([down, right, -forward, camera.position, [HEIGHT, WIDTH, 50.0]], axis=1)
        rows.append(np.concatenate([block.ravel(), [1.0, 10.0]]))
    np.save(root / "poses_bounds.npy", np.array(rows))
    return root
