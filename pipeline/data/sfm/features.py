"""What mapping and the registration of held-out cameras share: features, the verification of matches, lenses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap

from pipeline.data.sfm.job import Request


def find_features(database: Path, images: Path, files: list[str], request: Request) -> None:
    """SIFT features of `files` (in `images`) into the database, with a camera each, or one for all."""
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "PINHOLE" if request.poses_known else "SIMPLE_RADIAL"
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu, options.num_threads = False, 1
    options.sift.max_num_features = request.max_features
    alone = request.poses_known or not request.shared_intrinsics
    pycolmap.extract_features(
        database,
        images,
        image_names=files,
        reader_options=reader,
        extraction_options=options,
        camera_mode=pycolmap.CameraMode.PER_IMAGE if alone else pycolmap.CameraMode.SINGLE,
        device=pycolmap.Device.cpu,
    )
    if request.poses_known:
        with pycolmap.Database.open(database) as db:
            for image in db.read_all_images():
                camera = db.read_camera(image.camera_id)
                camera.params = request.camera_of(Path(image.name).stem)["intrinsics"]
                camera.has_prior_focal_length = True
                db.update_camera(camera)


def verification(request: Request) -> pycolmap.TwoViewGeometryOptions:
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed = request.seed
    return options


def lens_of(camera: pycolmap.Camera, cam_from_world: pycolmap.Rigid3d) -> dict:
    """As job.py writes it: intrinsics (fx, fy, cx, cy) in pixels, radial k, world_to_cam."""
    pose = np.vstack([cam_from_world.matrix(), [0, 0, 0, 1]])
    if camera.model_name == "PINHOLE":
        intrinsics, radial = list(camera.params), 0.0
    else:
        focal, cx, cy, radial = camera.params
        intrinsics = [focal, focal, cx, cy]
    return {"intrinsics": [float(x) for x in intrinsics], "radial": float(radial), "world_to_cam": pose.tolist()}
