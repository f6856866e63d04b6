"""Where a held-out camera stands, asked of a finished reconstruction without changing it.

Only for scenes without poses: to compare a render with what the camera saw, its pose must be known. Its features are
matched with those of the other photographs; a feature whose partner belongs to a point gives a pair (pixel, point), and
the pose that explains most pairs is taken. Points and other cameras stay as they are.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap

from pipeline.data.sfm.features import find_features, lens_of, verification
from pipeline.data.sfm.job import Request

MIN_PAIRS = 12  # explained by the pose; fewer could agree by chance


def register(name: str, model: pycolmap.Reconstruction, folder: Path, request: Request) -> dict | None:
    """The lens of photograph `name` as colmap.lens_of gives it; None if it can't be found."""
    database = folder / f"with_{name}.db"
    with pycolmap.Database.open(folder / "database.db"):
        database.write_bytes((folder / "database.db").read_bytes())
    find_features(database, folder / "images", [f"{name}.png"], request)
    pairs = folder / f"with_{name}.txt"
    others = sorted(image.name for image in model.images.values() if image.has_pose)
    pairs.write_text("".join(f"{name}.png {other}\n" for other in others))
    matching, pairing = pycolmap.FeatureMatchingOptions(), pycolmap.ImportedPairingOptions()
    matching.use_gpu, matching.num_threads = False, 1
    pairing.match_list_path = pairs
    pycolmap.match_image_pairs(
        database,
        matching_options=matching,
        pairing_options=pairing,
        verification_options=verification(request),
        device=pycolmap.Device.cpu,
    )

    pixels, points = [], []
    with pycolmap.Database.open(database) as db:
        mine = db.read_image_with_name(f"{name}.png")
        keypoints = db.read_keypoints(mine.image_id)[:, :2]
        for image in model.images.values():
            if not (image.has_pose and db.exists_matches(mine.image_id, image.image_id)):
                continue
            for own, other in db.read_two_view_geometry(mine.image_id, image.image_id).inlier_matches:
                if image.points2D[other].has_point3D():
                    pixels.append(keypoints[own])
                    points.append(model.points3D[image.points2D[other].point3D_id].xyz)
    if len(pixels) < MIN_PAIRS:
        return None
    # The lens: that of the others where they share one, else the likeliest for its size, then refined.
    camera = next(iter(model.cameras.values()))
    estimation, refinement = pycolmap.AbsolutePoseEstimationOptions(), pycolmap.AbsolutePoseRefinementOptions()
    estimation.ransac.random_seed = request.seed
    estimation.estimate_focal_length = refinement.refine_focal_length = not request.shared_intrinsics
    found = pycolmap.estimate_and_refine_absolute_pose(
        np.array(pixels), np.array(points), camera, estimation, refinement
    )
    if found is None or found["num_inliers"] < MIN_PAIRS:
        return None
    return lens_of(camera, found["cam_from_world"])
