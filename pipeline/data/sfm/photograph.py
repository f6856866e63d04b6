"""Input and output types of structure from motion: Photograph and Reconstruction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rasterizer.camera import Camera


@dataclass(frozen=True)
class Photograph:
    """One image; all photographs of a reconstruction show the same moment, or are frames of a clip."""

    name: str  # of the camera, unique
    image: np.ndarray  # (H, W, 3) uint8
    camera: Camera | None = None  # None: pose and intrinsics are to be estimated
    held_out: bool = False  # only its pose is estimated; points and other poses must not depend on it
    lens: str = ""  # of several cameras that move: the one that took it; its photographs share intrinsics and colours
    time: float = 0.0  # seconds of the common clock, of several cameras that move

    @property
    def camera_name(self) -> str:
        """Of the camera that took it: photographs of cameras that stand still are called after their camera."""
        return self.lens or self.name


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
