"""Registers held-out cameras against a finished reconstruction, which stays unchanged.

Only for scenes without poses: evaluation needs the pose of a held-out camera. Its features are matched with those of
the other photographs. Matches with features of points give pairs (pixel, point), and the pose is estimated from these
with RANSAC.
"""

from __future__ import annotations

from copy import copy
from pathlib import Path

import numpy as np
import pycolmap

from pipeline.data.sfm.features import camera_record, extract_features, match_pairs
from pipeline.data.sfm.job import SEED, Request, image_file, photograph_name

MIN_PAIRS = 12  # inliers; fewer may be consistent by coincidence


def register_held_out(
    name: str, model: pycolmap.Reconstruction, folder: Path, request: Request
) -> tuple[dict, list[tuple[int, float, float]]] | None:
    """The camera_record of photograph `name` and what it sees: (id of the point, x, y in pixels) of the inliers.

    None if there are too few of them.
    """
    database = folder / f"with_{name}.db"
    with pycolmap.Database.open(folder / "database.db"):
        database.write_bytes((folder / "database.db").read_bytes())
    extract_features(database, folder / "images", [image_file(name)], request)
    others = sorted(image.name for image in model.images.values() if image.has_pose)
    match_pairs(database, folder / f"with_{name}.txt", [[name, photograph_name(other)] for other in others])

    pixels, points, ids = [], [], []
    with pycolmap.Database.open(database) as db:
        held_out = db.read_image_with_name(image_file(name))
        assert held_out is not None  # extract_features has added it
        keypoints = db.read_keypoints(held_out.image_id)[:, :2]
        for image in model.images.values():
            if not (image.has_pose and db.exists_matches(held_out.image_id, image.image_id)):
                continue
            for own, other in db.read_two_view_geometry(held_out.image_id, image.image_id).inlier_matches:
                if image.points2D[other].has_point3D():
                    pixels.append(keypoints[own])
                    ids.append(image.points2D[other].point3D_id)
                    points.append(model.points3D[ids[-1]].xyz)
    if len(pixels) < MIN_PAIRS:
        return None
    # Initial intrinsics: of the shared camera, else of another camera, then refined.
    camera = copy(next(iter(model.cameras.values())))  # which is refined in place
    estimation, refinement = pycolmap.AbsolutePoseEstimationOptions(), pycolmap.AbsolutePoseRefinementOptions()
    estimation.ransac.random_seed = SEED
    estimation.estimate_focal_length = refinement.refine_focal_length = not request.shared_intrinsics
    found = pycolmap.estimate_and_refine_absolute_pose(
        np.array(pixels), np.array(points), camera, estimation, refinement
    )
    if found is None or found["num_inliers"] < MIN_PAIRS:
        return None
    # A feature matched in several photographs gives a pair for each: one is enough.
    inliers = {(ids[i], float(pixels[i][0]), float(pixels[i][1])) for i in np.flatnonzero(found["inlier_mask"])}
    return camera_record(camera, found["cam_from_world"]), sorted(inliers)
