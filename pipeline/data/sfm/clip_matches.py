"""Matches between the frames of a clip: those on what moves are dropped, and what they say of the camera's motion."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap

from pipeline.data.sfm.features import set_intrinsics, verification_options
from pipeline.data.sfm.job import Request, SfmError, photograph_name

STILL = 0.01  # image widths: matches between no two frames are farther apart than this if the camera stands still
TURNED = 0.05  # image widths: frames whose matches are farther apart tell whether the camera turns or moves
OUTWARD = 0.5  # cosine, median over pairs: sideways it is near 0, from a car 0.7 and more
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
    shifts = [pair.shift for pair in _verified_pairs(database)]
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
    turned = [pair.config in _ROTATIONS for pair in _verified_pairs(database) if pair.shift > TURNED]
    return bool(turned) and float(np.mean(turned)) >= TURNING_SHARE


def camera_drives(database: Path) -> bool:
    """Whether most pairs of frames are related by a motion along the camera's axis, as a car's: matches move away from
    the middle of the picture."""
    found = [pair for pair in _verified_pairs(database) if pair.shift > STILL]
    return bool(found) and float(np.median([abs(pair.outward) for pair in found])) > OUTWARD


@dataclass(frozen=True)
class _Pair:
    """A verified pair of frames."""

    config: pycolmap.TwoViewGeometryConfiguration
    shift: float  # median of the inlier matches, image widths
    outward: float  # mean cosine between their motion and the direction from the middle of the image


def _verified_pairs(database: Path) -> list[_Pair]:
    found = []
    with pycolmap.Database.open(database) as db:
        width = max(camera.width for camera in db.read_all_cameras())
        middle = {c.camera_id: 0.5 * np.array([c.width, c.height]) for c in db.read_all_cameras()}
        images = db.read_all_images()
        places = {i.image_id: db.read_keypoints(i.image_id)[:, :2] - middle[i.camera_id] for i in images}
        pairs, geometries = db.read_two_view_geometries()
        for pair, geometry in zip(pairs, geometries):
            matches = geometry.inlier_matches
            if len(matches) == 0:
                continue
            a, b = pycolmap.pair_id_to_image_pair(pair)
            here, motion = places[a][matches[:, 0]], places[b][matches[:, 1]] - places[a][matches[:, 0]]
            lengths = np.linalg.norm(motion, axis=1)
            cosines = (here * motion).sum(axis=1) / np.maximum(np.linalg.norm(here, axis=1) * lengths, 1e-9)
            config = pycolmap.TwoViewGeometryConfiguration(geometry.config)
            found.append(_Pair(config, float(np.median(lengths)) / width, float(cosines.mean())))
    return found
