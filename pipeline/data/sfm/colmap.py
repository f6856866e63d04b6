"""COLMAP on a folder of photographs: `python -m pipeline.data.sfm.colmap FOLDER`, a process of its own.

Apart, because pycolmap brings its own copies of common C libraries, which replace those of packages loaded after it: in
one process with Pillow, the first PNG written after `import pycolmap` ended in a "double free". A crash in there, too,
then costs one line and not the run. See job.py for the files that go in and come out.

All of COLMAP's random choices are seeded, and all of it runs on one thread: with several, images and matches are
numbered in the order they happen to be done, and what follows from them differs from run to run.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pycolmap

from pipeline.data.sfm.features import find_features, lens_of, verification
from pipeline.data.sfm.job import Found, Request, fail, read_request, write_found
from pipeline.data.sfm.registration import register

MIN_MODEL = 3  # photographs; two have no way to check each other


class SfmError(ValueError):
    """The photographs do not give what was asked of them."""


def main(folder: Path) -> None:
    pycolmap.logging.minloglevel = 3  # what goes wrong is said below, in one line
    request = read_request(folder)
    pycolmap.set_random_seed(request.seed)
    try:
        write_found(folder, reconstruct(folder, request))
    except SfmError as error:
        fail(folder, str(error))


def reconstruct(folder: Path, request: Request) -> Found:
    """Features, matches, then points: by triangulation where the poses are known, else with the poses."""
    database, images = folder / "database.db", folder / "images"
    used = [p.name for p in request.photographs if not p.held_out]
    find_features(database, images, [f"{name}.png" for name in used], request)
    match_features(database, request)
    model = triangulate(folder, request) if request.poses_known else map_cameras(folder, used, request)
    drop_doubtful_points(model, request)
    lenses = {name: _lens(model, name) for name in used}
    if not request.poses_known:
        for photograph in request.photographs:
            if photograph.held_out:
                lenses[photograph.name] = register(photograph.name, model, folder, request)
                if lenses[photograph.name] is None:
                    raise SfmError(
                        f"{photograph.name}: expected to find where the held-out camera stands, found too "
                        "few matches with the others"
                    )
    points = [model.points3D[index] for index in sorted(model.points3D)]
    return Found(
        points=np.array([p.xyz for p in points]).reshape(-1, 3),
        colors=np.array([p.color for p in points], np.uint8),
        errors=np.array([p.error for p in points]),
        track_lengths=np.array([len(p.track.elements) for p in points]),
        lenses=lenses,
    )


def match_features(database: Path, request: Request) -> None:
    """Matches of every pair of photographs, kept where one geometry of the pair explains them."""
    options = pycolmap.FeatureMatchingOptions()
    options.use_gpu, options.num_threads = False, 1
    pycolmap.match_exhaustive(
        database, matching_options=options, verification_options=verification(request), device=pycolmap.Device.cpu
    )


def triangulate(folder: Path, request: Request) -> pycolmap.Reconstruction:
    """Points for the known poses; with `refine_poses`, then both together, the poses' frame kept."""
    model = pycolmap.Reconstruction()
    with pycolmap.Database.open(folder / "database.db") as db:
        for image in db.read_all_images():
            model.add_camera_with_trivial_rig(db.read_camera(image.camera_id))
            pose = np.array(request.camera_of(Path(image.name).stem)["world_to_cam"])
            model.add_image_with_trivial_frame(
                pycolmap.Image(name=image.name, camera_id=image.camera_id, image_id=image.image_id),
                pycolmap.Rigid3d(pose[:3]),
            )
    model = _triangulate(model, folder, request)
    if request.refine_poses:
        given = {image.name: image.cam_from_world().matrix() for image in model.images.values()}
        options = pycolmap.BundleAdjustmentOptions()
        options.refine_focal_length = options.refine_extra_params = False
        options.print_summary, options.ceres.solver_options.num_threads = False, 1
        pycolmap.bundle_adjustment(model, options)
        refined = {image.name: image.cam_from_world().matrix() for image in model.images.values()}
        model.transform(back_to(np.array(list(given.values())), np.array([refined[name] for name in given])))
        model = _triangulate(model, folder, request)
    return model


def _triangulate(model: pycolmap.Reconstruction, folder: Path, request: Request) -> pycolmap.Reconstruction:
    output = folder / "model"
    output.mkdir(exist_ok=True)
    return pycolmap.triangulate_points(
        model, folder / "database.db", folder / "images", output, options=mapping(request)
    )


def map_cameras(folder: Path, used: list[str], request: Request) -> pycolmap.Reconstruction:
    """Poses and points together, COLMAP's incremental mapping. SfmError unless every photograph found its place."""
    output = folder / "model"
    output.mkdir(exist_ok=True)
    models = pycolmap.incremental_mapping(folder / "database.db", folder / "images", output, options=mapping(request))
    if not models:
        raise SfmError(f"expected {len(used)} photographs that show the same things, found no pair to start from")
    model = max(models.values(), key=lambda m: (m.num_reg_images(), m.num_points3D()))
    placed = {Path(image.name).stem for image in model.images.values() if image.has_pose}
    if missing := [name for name in used if name not in placed]:
        raise SfmError(
            f"expected to place all {len(used)} photographs, found no place for {', '.join(missing)}; "
            "scene.drop_cameras leaves cameras out"
        )
    return model


def mapping(request: Request) -> pycolmap.IncrementalPipelineOptions:
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = request.seed
    options.num_threads = options.mapper.num_threads = 1
    options.multiple_models, options.min_model_size = False, MIN_MODEL
    options.triangulation.ignore_two_view_tracks = request.min_track > 2
    options.triangulation.min_angle = options.mapper.filter_min_tri_angle = request.min_angle_deg
    return options


def drop_doubtful_points(model: pycolmap.Reconstruction, request: Request) -> None:
    """By reprojection error, track length, angle between rays and distance from the cameras."""
    model.update_point_3d_errors()
    places = {i: image.projection_center() for i, image in model.images.items() if image.has_pose}
    centre = np.mean(list(places.values()), axis=0)
    farthest = request.max_distance * request.unit if request.poses_known else np.inf
    for index, point in list(model.points3D.items()):
        rays = [places[element.image_id] - point.xyz for element in point.track.elements]
        if (
            point.error > request.max_error_px
            or len({e.image_id for e in point.track.elements}) < request.min_track
            or np.linalg.norm(point.xyz - centre) > farthest
            or widest_angle(rays) < request.min_angle_deg
        ):
            model.delete_point3D(index)


def widest_angle(rays: list[np.ndarray]) -> float:
    """Degrees between the two of `rays` (from a point to its cameras) that lie farthest apart."""
    unit = np.array(rays) / np.linalg.norm(rays, axis=1, keepdims=True)
    return float(np.degrees(np.arccos(np.clip(unit @ unit.T, -1, 1).min())))


def back_to(given: np.ndarray, refined: np.ndarray) -> pycolmap.Sim3d:
    """The similarity that takes the frame of the `refined` cameras to that of the `given` ones; (C, 3, 4) world_to_cam.

    Adjusting all cameras leaves the world's place, orientation and scale open. The orientation is taken from how the
    cameras are turned: their places alone leave it open too where they stand in a row.
    """
    turns = np.einsum("cij,cik->jk", given[:, :, :3], refined[:, :, :3])  # Σ R_givenᵀ R_refined
    u, _, vt = np.linalg.svd(turns)
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    places = [-np.einsum("cij,ci->cj", poses[:, :, :3], poses[:, :, 3]) for poses in (given, refined)]
    means = [x.mean(axis=0) for x in places]
    from_mean, turned = places[0] - means[0], (places[1] - means[1]) @ rotation.T
    scale = (from_mean * turned).sum() / (turned**2).sum()
    return pycolmap.Sim3d(scale, pycolmap.Rotation3d(rotation), means[0] - scale * rotation @ means[1])


def _lens(model: pycolmap.Reconstruction, name: str) -> dict:
    image = model.find_image_with_name(f"{name}.png")
    return lens_of(model.cameras[image.camera_id], image.cam_from_world())


if __name__ == "__main__":
    main(Path(sys.argv[1]))
