"""The pinhole camera that the whole project uses.

Camera axes follow COLMAP: x right, y down, z forward. Pixel (column i, row j) covers [i, i+1) × [j, j+1); its centre is
at (i + 0.5, j + 0.5).
"""

from __future__ import annotations

import numbers
from dataclasses import dataclass, replace

import numpy as np

from rasterizer.validation import as_float, short_repr

# Converts Blender/NeRF camera axes (x right, y up, z backward) to COLMAP's.
_BLENDER_TO_COLMAP = np.diag([1.0, -1.0, -1.0, 1.0])

MAX_SIDE = 65_536  # pixels: float32 still resolves 1/128 pixel there
MAX_PIXELS = 2**28  # the colour image alone is 3 GB
MIN_FOCAL, MAX_FOCAL = 1e-6, 1e9  # pixels; MAX_FOCAL also bounds the principal point
MAX_DISTANCE = 1e12  # world units: the product of three such lengths still fits in float32
RIGID_TOLERANCE = 1e-2  # of RᵀR - I: poses in files may be off by 1e-3 (readers/dnerf.py), their inverses by more


@dataclass(frozen=True)
class Camera:
    """A pinhole camera. Raises ValueError for a value that is not finite or out of range."""

    width: int  # pixels
    height: int
    fx: float  # pixels
    fy: float
    cx: float  # principal point, pixels
    cy: float
    world_to_cam: np.ndarray  # (4, 4) rigid transform: any array-like, stored as read-only float64

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            side = getattr(self, name)
            if not isinstance(side, numbers.Integral):
                raise ValueError(f"camera: {name} must be a whole number of pixels, got {short_repr(side)}")
            if not 1 <= int(side) <= MAX_SIDE:
                raise ValueError(
                    f"camera: width and height must be in 1..{MAX_SIDE} pixels, got {name} {short_repr(side)}"
                )
            object.__setattr__(self, name, int(side))
        if self.width * self.height > MAX_PIXELS:
            raise ValueError(
                f"camera: width × height must be at most {MAX_PIXELS} pixels, got {self.width} x {self.height}"
            )
        object.__setattr__(self, "world_to_cam", _rigid(self.world_to_cam))
        for name in ("fx", "fy", "cx", "cy"):
            object.__setattr__(self, name, as_float(getattr(self, name)))
        intrinsics = (self.fx, self.fy, self.cx, self.cy)
        if not (
            all(MIN_FOCAL <= f <= MAX_FOCAL for f in intrinsics[:2])
            and all(abs(c) <= MAX_FOCAL for c in intrinsics[2:])
        ):
            raise ValueError(
                f"camera: fx, fy must be > 0 and all intrinsics finite ({MIN_FOCAL:g} to "
                f"{MAX_FOCAL:g} pixels), got {intrinsics}"
            )

    @classmethod
    def from_blender(cls, width: int, height: int, focal: float, cam_to_world: np.ndarray) -> Camera:
        """From a NeRF/Blender camera-to-world matrix (4, 4) and a focal length in pixels; cx, cy at the centre."""
        world_to_cam = np.linalg.inv(np.asarray(cam_to_world, dtype=np.float64) @ _BLENDER_TO_COLMAP)
        return cls(width, height, focal, focal, width / 2, height / 2, world_to_cam)

    @property
    def position(self) -> np.ndarray:
        """Camera centre in world coordinates, (3,) float64: the solution of R x + t = 0.

        Not -Rᵀ t: the rotation of a pose stored in float32 is orthogonal only to 1e-7, and t may be large.
        """
        return -np.linalg.solve(self.world_to_cam[:3, :3], self.world_to_cam[:3, 3])

    def resized(self, width: int, height: int) -> Camera:
        """The same camera with its image resized to width × height pixels."""
        sx, sy = width / self.width, height / self.height
        return replace(
            self, width=width, height=height, fx=self.fx * sx, cx=self.cx * sx, fy=self.fy * sy, cy=self.cy * sy
        )


def _rigid(world_to_cam: object) -> np.ndarray:
    """A read-only float64 copy (4, 4); ValueError for anything that is no rigid transform."""
    try:
        pose = np.array(world_to_cam, dtype=np.float64)
    except (TypeError, ValueError, OverflowError, RuntimeError):  # RuntimeError: a tensor that requires grad
        raise ValueError(f"camera: world_to_cam must be (4, 4) numbers, got {short_repr(world_to_cam)}") from None
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
        raise ValueError(
            f"camera: world_to_cam must hold a rotation, its last row 0 0 0 1, got {short_repr(pose.tolist())}"
        )
    if np.abs(pose[:3, 3]).max() > MAX_DISTANCE:
        raise ValueError(f"camera: world_to_cam must move by at most {MAX_DISTANCE:g}, got {pose[:3, 3].tolist()}")
    pose.setflags(write=False)
    return pose
