"""The COLMAP process, `python -m pipeline.data.sfm.colmap FOLDER`: reconstructs the request in a job folder (job.py).

It is a separate process because pycolmap bundles copies of common C libraries, which replace those of packages loaded
later: with Pillow in the same process, the first PNG written after `import pycolmap` ended in a "double free". A crash
of COLMAP then also ends in an error message, not in a crash of the run.

All random numbers are seeded and everything runs on one thread: with several, the numbering of images and matches, and
with it the result, differs from run to run.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pycolmap

from datasets.outliers import without_outliers
from pipeline.data.sfm.clip_matches import (
    TURNS,
    camera_drives,
    camera_turns,
    keep_unmasked_matches,
    refuse_still_camera,
)
from pipeline.data.sfm.features import (
    camera_record,
    extract_features,
    match_pairs,
    matching_options,
    set_focal,
    verification_options,
)
from pipeline.data.sfm.job import (
    SEED,
    WHAT_TO_DRIVE,
    WHAT_TO_OVERLAP,
    ColmapResult,
    Request,
    SfmError,
    image_file,
    photograph_name,
    read_request,
    write_error,
    write_result,
)
from pipeline.data.sfm.registration import register_held_out

# Points are dropped beyond these:
MAX_ERROR_PX, MAX_RELATIVE_ERROR = 2.0, 1e-3  # reprojection error, of larger images a share of the longer side
MIN_TRACK = 3  # images that see it; two images agree on a wrong match too easily
MIN_ANGLE_DEG = 1.5  # between its rays: below, its depth is uncertain
MAX_DISTANCE = 100.0  # from the cameras' centre, normalised units (Scene.unit); with known poses only
ENOUGH = 0.8  # of a clip's frames; where fewer are registered and the camera drives, the mapping is tried anew
FOCALS_OF_CARS = (0.6, 0.9)  # × the longer side; COLMAP starts from 1.2, and motion along the axis corrects it little
MODELS_OF_CARS, SHARE_OF_CARS = 6, 0.3  # models at most, and the least share of the photographs in one
INITIAL_ANGLE_OF_CARS = 4.0  # degrees between the rays of the first pair; 16 elsewhere
MIN_MODEL = 3  # photographs; a third one is needed to verify two


def main(folder: Path) -> None:
    pycolmap.logging.minloglevel = 3  # errors are reported in one line below
    request = read_request(folder)
    pycolmap.set_random_seed(SEED)
    try:
        write_result(folder, reconstruct(folder, request))
    except SfmError as error:
        write_error(folder, error)


def reconstruct(folder: Path, request: Request) -> ColmapResult:
    """Features and matches, then triangulation if the poses are known, else incremental mapping; filtered points."""
    database, images = folder / "database.db", folder / "images"
    used = [p.name for p in request.photographs if not p.held_out]
    if request.masked:
        keep_unmasked_matches(database, folder / "masks", request)
    else:
        for lens in request.lenses or [used]:
            extract_features(database, images, [image_file(name) for name in lens], request)
        match_features(database, folder, request)
    if request.pairs is not None and not request.poses_known:
        refuse_still_camera(database)
    model = triangulate(folder, request) if request.poses_known else estimate_cameras(folder, used, request)
    filter_points(model, request)
    registered = {photograph_name(image.name) for image in model.images.values() if image.has_pose}
    cameras = {name: _camera_record(model, name) for name in used if name in registered}
    seen = _seen(model, list(cameras)) if request.observations else []
    if not request.poses_known:
        for photograph in request.photographs:
            if photograph.held_out:
                found = register_held_out(photograph.name, model, folder, request)
                if found is None:
                    raise SfmError(
                        f"{photograph.name}: expected to estimate the pose of the held-out camera, found too "
                        "few matches with the others"
                    )
                cameras[photograph.name], inliers = found
                seen += [(point, len(cameras) - 1, x, y) for point, x, y in inliers] if request.observations else []
    rows = {index: row for row, index in enumerate(sorted(model.points3D))}
    points = [model.points3D[index] for index in rows]
    return ColmapResult(
        points=np.array([p.xyz for p in points]).reshape(-1, 3),
        colors=np.array([p.color for p in points], np.uint8),
        errors=np.array([p.error for p in points]),
        track_lengths=np.array([len(p.track.elements) for p in points]),
        cameras=cameras,
        observations=np.array([(rows[point], *rest) for point, *rest in seen]).reshape(-1, 4)
        if request.observations
        else None,
        drives=request.pairs is not None and camera_drives(database),
    )


def _seen(model: pycolmap.Reconstruction, cameras: list[str]) -> list[tuple[int, int, float, float]]:
    """(id of the point, place of its camera, x, y in pixels) of every feature that became a point."""
    seen = []
    for place, name in enumerate(cameras):
        image = model.find_image_with_name(image_file(name))
        seen += [(p.point3D_id, place, float(p.xy[0]), float(p.xy[1])) for p in image.points2D if p.has_point3D()]
    return seen


def match_features(database: Path, folder: Path, request: Request) -> None:
    """Matching with geometric verification: of request.pairs, or of all photographs with all."""
    if request.pairs is not None:
        match_pairs(database, folder / "pairs.txt", request.pairs)
        return
    pycolmap.match_exhaustive(
        database,
        matching_options=matching_options(),
        verification_options=verification_options(),
        device=pycolmap.Device.cpu,
    )


def triangulate(folder: Path, request: Request) -> pycolmap.Reconstruction:
    """Points for the known poses. With `refine_poses` bundle adjustment follows, aligned to the given poses."""
    model = pycolmap.Reconstruction()
    with pycolmap.Database.open(folder / "database.db") as db:
        for image in db.read_all_images():
            model.add_camera_with_trivial_rig(db.read_camera(image.camera_id))
            pose = np.array(request.camera_of(photograph_name(image.name))["world_to_cam"])
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
        model.transform(align_cameras(np.array(list(given.values())), np.array([refined[name] for name in given])))
        model = _triangulate(model, folder, request)
    return model


def _triangulate(model: pycolmap.Reconstruction, folder: Path, request: Request) -> pycolmap.Reconstruction:
    output = folder / "model"
    output.mkdir(exist_ok=True)
    return pycolmap.triangulate_points(
        model, folder / "database.db", folder / "images", output, options=pipeline_options(request)
    )


def estimate_cameras(folder: Path, used: list[str], request: Request) -> pycolmap.Reconstruction:
    """COLMAP's incremental mapping: poses and points. SfmError unless all photographs are registered."""
    database = folder / "database.db"
    model = _mapped(folder, request)
    drives = request.pairs is not None and camera_drives(database)
    for focal in (None,) if request.intrinsics else FOCALS_OF_CARS:
        if drives and _registered(model) < ENOUGH * len(used):
            model = max(model, _mapped(folder, request, focal, along_axis=True), key=_registered)
    if model is None:
        turns = request.pairs is not None and camera_turns(database)
        found = f"no initial pair{TURNS if turns else ''}" + (f"; {WHAT_TO_DRIVE}" if drives else "")
        raise SfmError(f"expected {len(used)} photographs of the same objects, found {found}", turns)
    registered = {photograph_name(image.name) for image in model.images.values() if image.has_pose}
    missing = [name for name in used if name not in registered]
    if request.pairs is not None and len(registered) < request.least_registered * len(used):
        turns = camera_turns(database)
        advice = WHAT_TO_DRIVE if drives else WHAT_TO_OVERLAP
        raise SfmError(
            f"expected to find the camera of {request.least_registered:.0%} of {len(used)} frames, found that of "
            f"{len(registered)}{TURNS if turns else ''}; {advice}",
            turns,
        )
    if missing and request.pairs is None:
        raise SfmError(
            f"expected to register all {len(used)} photographs, found no pose for {', '.join(missing)}; "
            "scene.drop_cameras leaves cameras out"
        )
    return model


def _mapped(
    folder: Path, request: Request, focal: float | None = None, along_axis: bool = False
) -> pycolmap.Reconstruction | None:
    """The model with the most photographs; None without any. focal: to start from, × the longer side. along_axis: also
    from a pair whose cameras are one behind the other, whose rays meet at small angles."""
    database, output = folder / "database.db", folder / "model"
    output.mkdir(exist_ok=True)
    if focal is not None:
        set_focal(database, focal)
    options = pipeline_options(request)
    if along_axis:
        options.mapper.init_max_forward_motion, options.mapper.init_min_tri_angle = 1.0, INITIAL_ANGLE_OF_CARS
        # A first pair may lead to a handful of photographs: such a model is dropped, and another pair is tried.
        options.multiple_models, options.max_num_models = True, MODELS_OF_CARS
        options.min_model_size = max(MIN_MODEL, round(SHARE_OF_CARS * len(request.photographs)))
    models = pycolmap.incremental_mapping(database, folder / "images", output, options=options)
    return max(models.values(), key=lambda m: (m.num_reg_images(), m.num_points3D()), default=None)


def _registered(model: pycolmap.Reconstruction | None) -> int:
    return 0 if model is None else model.num_reg_images()


def pipeline_options(request: Request) -> pycolmap.IncrementalPipelineOptions:
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = SEED
    options.num_threads = options.mapper.num_threads = 1
    options.multiple_models, options.min_model_size = False, MIN_MODEL
    options.triangulation.ignore_two_view_tracks = MIN_TRACK > 2
    options.triangulation.min_angle = options.mapper.filter_min_tri_angle = MIN_ANGLE_DEG
    return options


def filter_points(model: pycolmap.Reconstruction, request: Request) -> None:
    """Deletes points by reprojection error, track length, triangulation angle and distance from the cameras."""
    model.update_point_3d_errors()
    positions = {i: image.projection_center() for i, image in model.images.items() if image.has_pose}
    centre = np.mean(without_outliers(np.stack(list(positions.values()))), axis=0)
    side = max(max(camera.width, camera.height) for camera in model.cameras.values())
    farthest = MAX_DISTANCE * request.unit if request.poses_known else np.inf
    for index, point in list(model.points3D.items()):
        rays = [positions[element.image_id] - point.xyz for element in point.track.elements]
        if (
            point.error > max(MAX_ERROR_PX, MAX_RELATIVE_ERROR * side)
            or len({e.image_id for e in point.track.elements}) < MIN_TRACK
            or np.linalg.norm(point.xyz - centre) > farthest
            or widest_angle(rays) < MIN_ANGLE_DEG
        ):
            model.delete_point3D(index)


def widest_angle(rays: list[np.ndarray]) -> float:
    """The largest angle in degrees between two of `rays`, from a point to its cameras."""
    unit = np.array(rays) / np.linalg.norm(rays, axis=1, keepdims=True)
    return float(np.degrees(np.arccos(np.clip(unit @ unit.T, -1, 1).min())))


def align_cameras(given: np.ndarray, refined: np.ndarray) -> pycolmap.Sim3d:
    """The similarity that aligns the `refined` cameras with the `given` ones; both (C, 3, 4) world_to_cam.

    Bundle adjustment leaves position, orientation and scale of the world undetermined. The rotation follows from the
    cameras' rotations, because collinear positions do not determine it; scale and shift from the positions.
    """
    correlation = np.einsum("cij,cik->jk", given[:, :, :3], refined[:, :, :3])  # Σ R_givenᵀ R_refined
    u, _, vt = np.linalg.svd(correlation)
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    positions = [-np.einsum("cij,ci->cj", poses[:, :, :3], poses[:, :, 3]) for poses in (given, refined)]
    means = [x.mean(axis=0) for x in positions]
    target, source = positions[0] - means[0], (positions[1] - means[1]) @ rotation.T
    scale = (target * source).sum() / (source**2).sum()
    return pycolmap.Sim3d(scale, pycolmap.Rotation3d(rotation), means[0] - scale * rotation @ means[1])


def _camera_record(model: pycolmap.Reconstruction, name: str) -> dict:
    image = model.find_image_with_name(image_file(name))
    return camera_record(model.cameras[image.camera_id], image.cam_from_world())


if __name__ == "__main__":
    main(Path(sys.argv[1]))
