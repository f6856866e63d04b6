"""Whether photographs without times are a film, or of one instant: numbers in names count frames or cameras alike.

The frames of a film lie close together on its path, and look about the same way. The cameras of a rig have the scene
between them: of 21 and 81 real ones around a person, neighbours in the order of names are 17° and 0.2 of the rig's size
apart, frames of real films 0.2° to 4° and 0.006 to 0.05 of the path.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from datasets.outliers import inliers
from datasets.photographs.name_splits import CAMERA_WORD
from datasets.photographs.photograph import PosedFile
from datasets.scene import camera_extent

# Of consecutive photographs, the median; a film has one or both.
LARGEST_STEP = 0.1  # of the extent of the cameras (scene.camera_extent)
LARGEST_ANGLE_DEG = 8.0  # between their orientations


def are_filmed(photographs: Sequence[PosedFile]) -> bool:
    """Whether photographs of one group, in the order of their names, are frames of a film.

    Not if a word before the last number of each name says that it is a camera's: cam03.
    """
    if all(CAMERA_WORD.search(re.sub(r"\d+\D*$", "", photograph.path.stem)) for photograph in photographs):
        return False
    cameras = [photograph.camera for photograph in photographs]
    kept = inliers(np.stack([camera.position for camera in cameras]))
    cameras = [camera for camera, inside in zip(cameras, kept) if inside]
    if len(cameras) < 2:
        return False
    steps = [float(np.linalg.norm(b.position - a.position)) for a, b in pairwise(cameras)]
    cosines = [0.5 * (np.sum(a.world_to_cam[:3, :3] * b.world_to_cam[:3, :3]) - 1) for a, b in pairwise(cameras)]
    angle = float(np.degrees(np.arccos(np.clip(np.median(cosines), -1, 1))))
    return float(np.median(steps)) <= LARGEST_STEP * camera_extent(cameras) or angle <= LARGEST_ANGLE_DEG
