"""Matches between the frames of a clip: those on what moves are dropped, and what they say of the camera's motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap

from pipeline.data.sfm.features import set_intrinsics, verification_options
from pipeline.data.sfm.job import Request, SfmError, photograph_name

STILL = 0.01  # image widths: matches between no two frames are farther apart than this if the camera stands still
TURNED = 0.05  # image widths: frames whose matches are farther apart tell whether the camera turns or moves
TURNING_SHARE = 0.8  # of these pairs explained by a rotation, or by one plane
_ROTATIONS = (
    pycolmap.TwoViewGeometryConfiguration.PANORAMIC,
    pycolmap.TwoViewGeometryConfiguration.PLANAR_OR_PANORAMIC,
)
WHAT_TO_FILM = "walk sideways around what you film, 5 to 20 seconds, rather than turning on the spot"
TURNS = f" (the camera turns without moving, which shows no depth: {WHAT_TO_FILM})"  # added to a message


def keep_unmasked_matches(database: Path, masks: Path, request: Request) -> None:
    """Drops the matches with an end where masks/<image>.npy is true, and verifies the others again."""
    if request.intrinsics is not None:
        set_intrinsics(database, request.intrinsics)
    with pycolmap.Database.open(database) as db:
        images = db.read_all_images()
        still = {image.image_id: _still(db, image, masks) for image in images}
        pairs, matches = db.read_all_matches()
        db.clear_matches()
        db.clear_two_view_geometries()
        names = {image.image_id: image.name for image in images}
        kept = []
        for pair, found in zip(pairs, matches):
            a, b = pycolmap.pair_id_to_image_pair(pair)
            both = still[a][found[:, 0]] & still[b][found[:, 1]]
            db.write_matches(a, b, found[both])
            kept.append(f"{names[a]} {names[b]}\n")
    file = database.with_name("kept.txt")
    file.write_text("".join(kept))
    pycolmap.verify_matches(database, file, verification_options())


def _still(db: pycolmap.Database, image: pycolmap.Image, masks: Path) -> np.ndarray:
    """(features,) bool: not where the image's mask is true; all of them without a mask."""
    keypoints = db.read_keypoints(image.image_id)[:, :2]
    file = masks / f"{photograph_name(image.name)}.npy"
    if not file.exists():
        return np.ones(len(keypoints), bool)
    moving = np.load(file)
    column, row = (np.clip(keypoints[:, i].astype(int), 0, moving.shape[1 - i] - 1) for i in (0, 1))
    return ~moving[row, column]


def refuse_still_camera(database: Path) -> None:
    """SfmError for frames that do not overlap, and for a camera that does not move."""
    shifts = [shift for _, shift in _verified_pairs(database)]
    if not shifts:
        raise SfmError(
            "expected frames that show the same objects, found no two that match: too dark, too blurred, or too little "
            "texture; film slowly and in good light"
        )
    if max(shifts) < STILL:
        raise SfmError(
            f"expected a camera that moves, found one that stands still (the picture shifts by {max(shifts):.1%} of "
            f"its width at most), which shows no depth; {WHAT_TO_FILM}, or film with several cameras at once"
        )


def camera_turns(database: Path) -> bool:
    """Whether most pairs of frames are related by a rotation alone."""
    turned = [config in _ROTATIONS for config, shift in _verified_pairs(database) if shift > TURNED]
    return bool(turned) and float(np.mean(turned)) >= TURNING_SHARE


def _verified_pairs(database: Path) -> list[tuple[pycolmap.TwoViewGeometryConfiguration, float]]:
    """(configuration, median shift of the inlier matches in image widths) of each verified pair of frames."""
    found = []
    with pycolmap.Database.open(database) as db:
        width = max(camera.width for camera in db.read_all_cameras())
        keypoints = {image.image_id: db.read_keypoints(image.image_id)[:, :2] for image in db.read_all_images()}
        pairs, geometries = db.read_two_view_geometries()
        for pair, geometry in zip(pairs, geometries):
            matches = geometry.inlier_matches
            if len(matches) == 0:
                continue
            a, b = pycolmap.pair_id_to_image_pair(pair)
            shift = np.linalg.norm(keypoints[a][matches[:, 0]] - keypoints[b][matches[:, 1]], axis=1)
            found.append((pycolmap.TwoViewGeometryConfiguration(geometry.config), float(np.median(shift)) / width))
    return found
