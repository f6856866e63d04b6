"""`Reconstruction`: the result of structure from motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rasterizer.camera import Camera


@dataclass(frozen=True)
class CalibratedCamera:
    """A camera of a reconstruction: a pinhole camera and the radial distortion of its lens."""

    camera: Camera
    radial: float = 0.0  # k of COLMAP's SIMPLE_RADIAL, OpenCV's k1: x' = x (1 + k r²), coordinates at z = 1


@dataclass(frozen=True)
class Reconstruction:
    """Surface points at one moment and the cameras. World units are those of the given poses, or arbitrary."""

    points: np.ndarray  # (N, 3) float64
    colors: np.ndarray  # (N, 3) uint8
    errors: np.ndarray  # (N,) mean reprojection error, pixels
    track_lengths: np.ndarray  # (N,) number of images that show the point
    cameras: dict[str, CalibratedCamera]  # by name of the photograph
    poses: str  # known | refined | estimated
    photographs: int  # number used for the points, without held-out ones
    seconds: float
    # (M, 4) float64, where asked for: row of the point, place of the camera in `cameras`, x and y in pixels
    observations: np.ndarray | None = None

    def summary(self) -> dict[str, float | int | str]:
        """The content of sfm.json."""
        return {
            "points": len(self.points),
            "mean_error_px": float(self.errors.mean()),
            "mean_track_length": float(self.track_lengths.mean()),
            "cameras": self.photographs,
            "registered": min(self.photographs, len(self.cameras)),
            "seconds": self.seconds,
            "poses": self.poses,
        }
