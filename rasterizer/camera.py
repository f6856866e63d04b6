"""The pinhole camera every part of the project shares.

Axes are COLMAP's: x right, y down, the camera looks along +z. Pixel (column i, row j) covers
[i, i+1) × [j, j+1); its centre is at (i + 0.5, j + 0.5).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

# Flips Blender/NeRF camera axes (x right, y up, z backward) to COLMAP's (x right, y down, z forward).
_BLENDER_TO_COLMAP = np.diag([1.0, -1.0, -1.0, 1.0])


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
            if not isinstance(getattr(self, name), (int, np.integer)):
                raise ValueError(f"camera: {name} must be a whole number of pixels, got {getattr(self, name)!r}")
        if self.width < 1 or self.height < 1:
            raise ValueError(f"camera: width and height must be >= 1, got {self.width} x {self.height}")
        pose = np.array(self.world_to_cam, dtype=np.float64)
        if pose.shape != (4, 4):
            raise ValueError(f"camera: world_to_cam must be (4, 4), got {pose.shape}")
        if not np.isfinite(pose).all():
            raise ValueError("camera: world_to_cam must be finite, got NaN or Inf")
        if np.linalg.matrix_rank(pose[:3, :3]) < 3:
            raise ValueError(f"camera: world_to_cam must hold a rotation, got rows {pose[:3, :3].tolist()}")
        intrinsics = (self.fx, self.fy, self.cx, self.cy)
        if not np.isfinite(intrinsics).all() or self.fx <= 0 or self.fy <= 0:
            raise ValueError(f"camera: fx, fy must be > 0 and all intrinsics finite, got {intrinsics}")
        pose.setflags(write=False)
        object.__setattr__(self, "world_to_cam", pose)

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
        return replace(self, width=width, height=height,
                       fx=self.fx * sx, cx=self.cx * sx, fy=self.fy * sy, cy=self.cy * sy)
