"""The pinhole camera every part of the project shares.

Axes are COLMAP's: x right, y down, the camera looks along +z. Pixel (column i, row j) covers
[i, i+1) × [j, j+1); its centre is at (i + 0.5, j + 0.5).
"""

from __future__ import annotations

import numbers
from dataclasses import dataclass, replace

import numpy as np

from rasterizer.number import as_float, shown

# Flips Blender/NeRF camera axes (x right, y up, z backward) to COLMAP's (x right, y down, z forward).
_BLENDER_TO_COLMAP = np.diag([1.0, -1.0, -1.0, 1.0])

LARGEST_SIDE = 65_536  # pixels: there float32 still tells 1/128 of one
LARGEST_IMAGE = 2**28  # pixels: colour alone is 3 GB
SHORTEST_FOCAL, LONGEST_FOCAL = 1e-6, 1e9  # pixels; also how far off the image its principal point may lie
FARTHEST = 1e12  # world units: float32, which ends at 3e38, holds three such lengths multiplied
RIGID_TOLERANCE = 1e-2  # of RᵀR: a file's pose may be off by 1e-3 (datasets/dnerf.py), its inverse by more


@dataclass(frozen=True)
class Camera:
    """A pinhole camera.

    width, height: pixels. fx, fy, cx, cy: pixels. world_to_cam: (4, 4) rigid transform, anything
    array-like; kept as float64 numpy. Raises ValueError when a value is not finite or not in range.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    world_to_cam: np.ndarray  # (4, 4)

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            side = getattr(self, name)
            if not isinstance(side, numbers.Integral):
                raise ValueError(f"camera: {name} must be a whole number of pixels, got {shown(side)}")
            if not 1 <= side <= LARGEST_SIDE:
                raise ValueError(
                    f"camera: width and height must be in 1..{LARGEST_SIDE} pixels, got {name} {shown(side)}"
                )
            object.__setattr__(self, name, int(side))
        if self.width * self.height > LARGEST_IMAGE:
            raise ValueError(
                f"camera: width × height must be at most {LARGEST_IMAGE} pixels, got {self.width} x {self.height}"
            )
        object.__setattr__(self, "world_to_cam", _rigid(self.world_to_cam))
        for name in ("fx", "fy", "cx", "cy"):
            object.__setattr__(self, name, as_float(getattr(self, name)))
        intrinsics = (self.fx, self.fy, self.cx, self.cy)
        if not (
            all(SHORTEST_FOCAL <= f <= LONGEST_FOCAL for f in intrinsics[:2])
            and all(abs(c) <= LONGEST_FOCAL for c in intrinsics[2:])
        ):
            raise ValueError(
                f"camera: fx, fy must be > 0 and all intrinsics finite ({SHORTEST_FOCAL:g} to "
                f"{LONGEST_FOCAL:g} pixels), got {intrinsics}"
            )

    @classmethod
    def from_blender(cls, width: int, height: int, focal: float, cam_to_world: np.ndarray) -> Camera:
        """From a NeRF/Blender camera-to-world matrix (4, 4), principal point at the centre, focal in pixels."""
        world_to_cam = np.linalg.inv(np.asarray(cam_to_world, dtype=np.float64) @ _BLENDER_TO_COLMAP)
        return cls(width, height, focal, focal, width / 2, height / 2, world_to_cam)

    @property
    def position(self) -> np.ndarray:
        """Camera centre in world coordinates, (3,): the point whose camera coordinates are 0.

        That is -Rᵀ t, but a pose stored in float32 is a rotation only to 1e-7, and t may be large.
        """
        return -np.linalg.solve(self.world_to_cam[:3, :3], self.world_to_cam[:3, 3])

    def resized(self, width: int, height: int) -> Camera:
        """The same camera with its image resampled to width × height pixels."""
        sx, sy = width / self.width, height / self.height
        return replace(
            self, width=width, height=height, fx=self.fx * sx, cx=self.cx * sx, fy=self.fy * sy, cy=self.cy * sy
        )


def _rigid(world_to_cam: object) -> np.ndarray:
    """(4, 4) float64, not writable; ValueError for anything but a rotation and a translation."""
    try:
        pose = np.array(world_to_cam, dtype=np.float64)
    except (TypeError, ValueError, OverflowError, RuntimeError):  # RuntimeError: a tensor that wants a gradient
        raise ValueError(f"camera: world_to_cam must be (4, 4) numbers, got {shown(world_to_cam)}") from None
    if pose.shape != (4, 4):
        raise ValueError(f"camera: world_to_cam must be (4, 4), got {pose.shape}")
    if not np.isfinite(pose).all():
        raise ValueError("camera: world_to_cam must be finite, got NaN or Inf")
    rotation = pose[:3, :3]
    if not (
        np.abs(rotation).max() <= 2
        and np.abs(rotation.T @ rotation - np.eye(3)).max() <= RIGID_TOLERANCE
        and np.linalg.det(rotation) > 0
        and np.abs(pose[3] - [0, 0, 0, 1]).max() <= RIGID_TOLERANCE
    ):
        raise ValueError(f"camera: world_to_cam must hold a rotation, its last row 0 0 0 1, got {shown(pose.tolist())}")
    if np.abs(pose[:3, 3]).max() > FARTHEST:
        raise ValueError(f"camera: world_to_cam must move by at most {FARTHEST:g}, got {pose[:3, 3].tolist()}")
    pose.setflags(write=False)
    return pose
