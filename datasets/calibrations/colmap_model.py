"""A model of COLMAP as the calibration of a rig: cameras and images, one image for each camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from datasets.calibrations.rig import Rig, RigCamera
from datasets.files.colmap_files import read_cameras, read_images
from datasets.files.errors import SceneError
from datasets.readers.colmap import FISHEYE, OPENCV, rotation_of


def images_file(folder: Path) -> Path | None:
    return next((file for suffix in ("bin", "txt") if (file := folder / f"images.{suffix}").is_file()), None)


def read(folder: Path) -> Rig:
    """An image is called after its file; one in a folder of its own after the folder."""
    file = images_file(folder)
    if file is None:
        raise SceneError(folder, "images.bin or images.txt", "neither")
    lenses, found = read_cameras(file.with_stem("cameras")), read_images(file)
    parts = [Path(image.name.replace("\\", "/")) for image in found]
    folders = [part.parent.name for part in parts]
    alone = len(set(folders)) == len(folders)  # left/0001.png, right/0001.png
    cameras = []
    for image, part, inner in zip(found, parts, folders):
        where = f"{file}: {image.name}"
        if (lens := lenses.get(image.camera)) is None:
            raise SceneError(where, f"a camera among {', '.join(map(str, sorted(lenses)))}", f"{image.camera}")
        if lens.model not in (*OPENCV, *FISHEYE):
            raise SceneError(where, ", ".join((*OPENCV, *FISHEYE)), lens.model)
        single = lens.model.startswith("SIMPLE") or lens.model in ("RADIAL", "RADIAL_FISHEYE")
        p = lens.parameters
        fx, fy, cx, cy = (p[0], *p[:3]) if single else p[:4]
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation_of(image.quaternion, where), image.translation
        bent, fisheye = tuple(p[3 if single else 4 :]), lens.model in FISHEYE
        name, size = inner if alone and inner else part.stem, (lens.width, lens.height)
        cameras.append(RigCamera(name, size, (fx, fy, cx, cy), bent, pose, where, fisheye))
    return Rig("COLMAP", tuple(cameras))
