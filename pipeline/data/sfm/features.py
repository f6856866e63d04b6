"""pycolmap calls that mapping and registration share: SIFT features, seeded verification, camera records."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap

from pipeline.data.sfm.job import SEED, Request, image_file, photograph_name


def extract_features(database: Path, images: Path, files: list[str], request: Request) -> None:
    """Writes SIFT features of `files` (in `images`) to the database, with one camera per image or one for all."""
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "PINHOLE" if request.poses_known else "SIMPLE_RADIAL"
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu, options.num_threads = False, 1
    options.sift.max_num_features = request.max_features
    camera_per_image = request.poses_known or not request.shared_intrinsics
    pycolmap.extract_features(
        database,
        images,
        image_names=files,
        reader_options=reader,
        extraction_options=options,
        camera_mode=pycolmap.CameraMode.PER_IMAGE if camera_per_image else pycolmap.CameraMode.SINGLE,
        device=pycolmap.Device.cpu,
    )
    if request.poses_known:
        with pycolmap.Database.open(database) as db:
            for image in db.read_all_images():
                camera = db.read_camera(image.camera_id)
                camera.params = request.camera_of(photograph_name(image.name))["intrinsics"]
                camera.has_prior_focal_length = True
                db.update_camera(camera)


def set_intrinsics(database: Path, intrinsics: dict[str, list[float]]) -> None:
    """Gives the cameras of photographs [focal, cx, cy, k] as initial values that verification trusts."""
    with pycolmap.Database.open(database) as db:
        cameras = {camera.camera_id: camera for camera in db.read_all_cameras()}
        for image in db.read_all_images():
            if photograph_name(image.name) in intrinsics:
                cameras[image.camera_id].params = intrinsics[photograph_name(image.name)]
                cameras[image.camera_id].has_prior_focal_length = True
        for camera in cameras.values():
            db.update_camera(camera)


def set_focal(database: Path, focal: float) -> None:
    """Gives all cameras a focal length to start from, × the longer side of their images."""
    with pycolmap.Database.open(database) as db:
        for camera in db.read_all_cameras():
            first, *others = camera.params
            camera.params = [focal * max(camera.width, camera.height), *others]
            db.update_camera(camera)


def match_pairs(database: Path, file: Path, pairs: list[list[str]]) -> None:
    """Matches and verifies pairs of photographs; writes them to `file`, where COLMAP reads them."""
    file.write_text("".join(f"{image_file(a)} {image_file(b)}\n" for a, b in pairs))
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = file
    pycolmap.match_image_pairs(
        database,
        matching_options=matching_options(),
        pairing_options=pairing,
        verification_options=verification_options(),
        device=pycolmap.Device.cpu,
    )


def matching_options() -> pycolmap.FeatureMatchingOptions:
    options = pycolmap.FeatureMatchingOptions()
    options.use_gpu, options.num_threads = False, 1
    return options


def verification_options() -> pycolmap.TwoViewGeometryOptions:
    """Geometric verification of matches, seeded."""
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed = SEED
    return options


def camera_record(camera: pycolmap.Camera, cam_from_world: pycolmap.Rigid3d) -> dict:
    """A camera as JSON: intrinsics [fx, fy, cx, cy] in pixels, radial distortion k, world_to_cam (4, 4)."""
    pose = np.vstack([cam_from_world.matrix(), [0, 0, 0, 1]])
    if camera.model_name == "PINHOLE":
        intrinsics, radial = list(camera.params), 0.0
    else:
        focal, cx, cy, radial = camera.params
        intrinsics = [focal, focal, cx, cy]
    return {"intrinsics": [float(x) for x in intrinsics], "radial": float(radial), "world_to_cam": pose.tolist()}
