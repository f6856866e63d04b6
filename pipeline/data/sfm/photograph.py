"""What goes into structure from motion and what comes out of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rasterizer.camera import Camera


@dataclass(frozen=True)
class Photograph:
    """One image of the moment to reconstruct."""

    name: str  # of the camera, unique
    image: np.ndarray  # (H, W, 3) uint8
    camera: Camera | None = None  # None: where it stood and through what lens is to be found out
    held_out: bool = False  # its pose is wanted, but no point and no other pose may depend on it


@dataclass(frozen=True)
class Lens:
    """A camera found by structure from motion: a pinhole, and how far the real lens departs from it."""

    camera: Camera
    radial: float = 0.0  # k of COLMAP's SIMPLE_RADIAL, OpenCV's k1: x' = x (1 + k r²), coordinates at z = 1


@dataclass(frozen=True)
class Reconstruction:
    """Points on the surfaces at one moment, and the cameras that saw them. World units as the poses', if known."""

    points: np.ndarray  # (N, 3) float64
    colors: np.ndarray  # (N, 3) uint8
    errors: np.ndarray  # (N,) pixels, mean distance between a point's projections and its features
    track_lengths: np.ndarray  # (N,) images each is seen in
    lenses: dict[str, Lens]  # by name of the photograph
    poses: str  # known | refined | estimated
    photographs: int  # that points were made from: the held-out ones are not among them
    seconds: float

    def summary(self) -> dict[str, float | int | str]:
        """What sfm.json says and the report shows."""
        return {
            "points": len(self.points),
            "mean_error_px": float(self.errors.mean()),
            "mean_track_length": float(self.track_lengths.mean()),
            "cameras": self.photographs,
            "registered": self.photographs,
            "seconds": self.seconds,
            "poses": self.poses,
        }
