"""Canonical coordinates: normalisation of every scene to one origin, one unit of length and one unit of time.

Training depends on units: 4D rotations mix space with time, learning rates are per unit of time, random points are
drawn in a cube around the origin, and float32 loses digits far from it. Every scene is therefore normalised first:

    canonical x = (x - centre) scale        canonical t = (t - time_origin) time_scale

Space: the origin is the least-squares intersection of the training cameras' optical axes, at a mean distance of 4
units, as in D-NeRF's scenes and the released program's converter. There is no rotation. Time: photographs take
[0, 1], D-NeRF's convention, and so do clips, cameras that move and driving logs; of videos of cameras that stand still
30 frames are one unit, which is a second of Plenoptic Video.

A scene that follows the convention within 10 % is left unchanged, bit for bit. Two scalings of one world that are both
within 10 % are therefore not made equal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from datasets.outliers import inliers, without_outliers
from datasets.scene import Box, Corner, Scene, Sweep, View, camera_extent
from rasterizer.camera import Camera

DISTANCE = 4.0  # mean distance of the training cameras from the origin
FRAMES_PER_UNIT = 30.0  # of videos of cameras that stand still
SHORTEST_DRIVE = 40.0  # metres: what a parked car sees is no smaller
TOLERANCE = 0.1  # relative deviation from the convention up to which a scene is left unchanged
# Relative. Removes the rounding of a frame rate that was computed from times in float64.
RATE_ROUNDING = 1e-9
# Below this angle between the axes (root mean square, to their mean) they count as parallel.
SMALLEST_ANGLE_DEG = 2.0
# Length of the mean of the unit vectors below which the cameras have no common direction, as on a ring around a scene.
SMALLEST_MEAN_DIRECTION = 0.5


@dataclass(frozen=True)
class Canonical:
    """The transform from a scene's own coordinates to canonical ones. The defaults are the identity."""

    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)  # world units
    scale: float = 1.0  # canonical units per world unit
    time_origin: float = 0.0  # the scene's unit of time; in videos relative to the first frame in use
    time_scale: float = 1.0  # canonical units per unit of the scene's time

    @property
    def keeps_space(self) -> bool:
        return (self.centre, self.scale) == (Canonical.centre, Canonical.scale)

    @property
    def keeps_time(self) -> bool:
        return (self.time_origin, self.time_scale) == (Canonical.time_origin, Canonical.time_scale)

    @property
    def is_identity(self) -> bool:
        return self.keeps_space and self.keeps_time

    @property
    def unit(self) -> float:
        """World units per canonical unit."""
        return 1.0 / self.scale

    @property
    def inverse(self) -> Canonical:
        """The transform from canonical coordinates to the scene's own."""
        x, y, z = self.centre
        return Canonical(
            (-self.scale * x, -self.scale * y, -self.scale * z),
            1.0 / self.scale,
            -self.time_scale * self.time_origin,
            1.0 / self.time_scale,
        )

    def then(self, other: Canonical) -> Canonical:
        """This transform and then `other`, in float64: large shifts cancel before coordinates become float32."""
        x, y, z = (own + its / self.scale for own, its in zip(self.centre, other.centre))
        origin = self.time_origin + other.time_origin / self.time_scale
        return Canonical((x, y, z), self.scale * other.scale, origin, self.time_scale * other.time_scale)

    def points(self, world: np.ndarray) -> np.ndarray:
        """(…, 3) world -> (…, 3) canonical, float64."""
        return (np.asarray(world, dtype=np.float64) - self.centre) * self.scale

    def time(self, time: float) -> float:
        """The scene's time -> canonical."""
        return (time - self.time_origin) * self.time_scale

    def camera(self, camera: Camera) -> Camera:
        """The same camera in canonical coordinates: points project to the same pixels, depths are × scale."""
        pose = camera.world_to_cam.copy()
        pose[:3, 3] = self.scale * (pose[:3, :3] @ self.centre + pose[:3, 3])
        return replace(camera, world_to_cam=pose)

    def box(self, world: Box) -> Box:
        """A box as Scene.init_box, world -> canonical; the same object if the transform keeps space."""
        if self.keeps_space:
            return world
        low, high = world
        return self._corner(low), self._corner(high)

    def _corner(self, world: Corner) -> Corner:
        x, y, z = self.points(np.broadcast_to(world, 3)).tolist()
        return x, y, z

    def to_dict(self) -> dict:
        """The content of canonical.json."""
        return {
            **asdict(self),
            "meaning": "canonical x = (x - centre) scale, canonical t = (t - time_origin) time_scale; a "
            "film's t counts from its first frame in use",
        }

    @classmethod
    def from_dict(cls, content: dict) -> Canonical:
        """The transform that `to_dict` describes."""
        centre = tuple(content["centre"])
        return cls(centre, content["scale"], content["time_origin"], content["time_scale"])

    def __str__(self) -> str:
        """The transform in one line of a log."""
        parts, centre = [], ", ".join(f"{x:.6g}" for x in self.centre)
        if not self.keeps_space:
            parts.append(f"x → (x - ({centre})) × {self.scale:.6g}")
        if not self.keeps_time:
            parts.append(f"t → (t - {self.time_origin:.15g}) × {self.time_scale:.6g}")
        return ", ".join(parts) or "as it is"


def canonical_of(scene: Scene) -> Canonical:
    """The transform for a scene, from its training cameras, its range of time and the frame rate of its videos."""
    cameras = [view.camera for view in scene.train]
    space = along_a_drive(cameras) if scene.capture == "drive" else canonical_space(cameras, scene.unit)
    if scene.frame_rate is None:
        time_scale = 1.0 / scene.duration
    else:
        time_scale = scene.frame_rate / FRAMES_PER_UNIT
        if abs(time_scale - 1.0) < RATE_ROUNDING:
            time_scale = 1.0
    return replace(space, time_origin=float(scene.time_start), time_scale=float(time_scale))


def along_a_drive(cameras: Sequence[Camera]) -> Canonical:
    """The spatial part of a driving log: the origin is the middle of the way, half of which is DISTANCE / 1.1 units.

    Optical axes say nothing here: they are parallel, or those of cameras to the side meet behind the car. Speeds are
    then alike in logs of any length, as times are in [0, 1]. A log of less than twice SHORTEST_DRIVE is not enlarged.
    """
    positions = without_outliers(np.stack([camera.position for camera in cameras]))
    unit = max(camera_extent(cameras), SHORTEST_DRIVE) / DISTANCE
    return Canonical(tuple((0.5 * (positions.min(axis=0) + positions.max(axis=0))).tolist()), 1.0 / unit)


def canonical_space(cameras: Sequence[Camera], unit: float | None = None) -> Canonical:
    """The spatial part of the transform, from the distinct training cameras; time is kept.

    The centre is the least-squares intersection of the optical axes. If they are nearly parallel or diverge, the
    centre lies DISTANCE canonical units in front of the mean camera, or at the mean camera if they have no common
    direction, and one canonical unit is `unit` world units (Scene.unit, or None for 3DGS's camera extent). All of
    these shift and scale with the world, so that the result does not depend on its unit and origin. Cameras that are
    outliers (outliers.py) do not count.
    """
    cameras = list({camera.world_to_cam.tobytes(): camera for camera in cameras}.values())
    positions = np.stack([camera.position for camera in cameras])
    if not (kept := inliers(positions)).all():
        cameras, positions = [camera for camera, inside in zip(cameras, kept) if inside], positions[kept]
    directions = np.stack([camera.world_to_cam[2, :3] for camera in cameras])
    middle = positions.mean(axis=0)
    around = positions - middle  # avoids cancellation far from the origin
    centre = intersect_axes(around, directions)
    if centre is not None:
        unit = float(np.linalg.norm(around - centre, axis=1).mean()) / DISTANCE
    else:
        unit = unit or camera_extent(cameras) or 1.0  # 1: cameras all at one place, which validate_scene refuses
        ahead = mean_direction(directions)
        centre = np.zeros(3) if ahead is None else DISTANCE * unit * ahead
    centre = middle + centre
    if abs(unit - 1.0) <= TOLERANCE and np.linalg.norm(centre) <= TOLERANCE * DISTANCE:
        return Canonical()
    return Canonical(tuple(centre.tolist()), 1.0 / unit)


def canonicalise(scene: Scene, transform: Canonical) -> Scene:
    """The scene in canonical coordinates; the same object if the transform is the identity."""
    if transform.is_identity:
        return scene
    cameras: dict[int, Camera] = {}  # by id: the frames of a video share their camera

    def view_of(view: View) -> View:
        key = id(view.camera)
        if key not in cameras:
            cameras[key] = transform.camera(view.camera)
        truth = view.truth and view.truth.in_units(transform.scale, transform.time_scale)
        return replace(view, camera=cameras[key], time=transform.time(view.time), truth=truth)

    def sweep_of(sweep: Sweep) -> Sweep:
        time, origin = transform.time(sweep.time), transform.points(sweep.origin)
        return replace(sweep, time=time, origin=origin, points=transform.points(sweep.points))

    return replace(
        scene,
        train=tuple(map(view_of, scene.train)),
        test=tuple(map(view_of, scene.test)),
        sweeps=tuple(map(sweep_of, scene.sweeps)),
        test_sweeps=tuple(map(sweep_of, scene.test_sweeps)),
        duration=scene.duration * transform.time_scale,
        time_start=transform.time(scene.time_start),
        extent=scene.extent * transform.scale,
        init_box=transform.box(scene.init_box),
        unit=scene.unit * transform.scale,
        seconds_per_unit=scene.seconds_per_unit / transform.time_scale,
        metre=None if scene.metre is None else scene.metre * transform.scale,
        frame_rate=None if scene.frame_rate is None else scene.frame_rate / transform.time_scale,
    )


def intersect_axes(positions: np.ndarray, directions: np.ndarray) -> np.ndarray | None:
    """The point (3,) with the least sum of squared distances to all optical axes.

    positions: (C, 3). directions: (C, 3) unit vectors. None if the axes are nearly parallel, or if the point lies
    behind most cameras.
    """
    projections = np.eye(3) - directions[:, :, None] * directions[:, None, :]  # (C, 3, 3) onto the normal planes
    system = projections.mean(axis=0)
    # The smallest eigenvalue is the mean squared sine of the angle between the axes and their common direction.
    if np.linalg.eigvalsh(system)[0] < np.sin(np.radians(SMALLEST_ANGLE_DEG)) ** 2:
        return None
    point = np.linalg.solve(system, np.einsum("nij,nj->i", projections, positions) / len(positions))
    depths = np.sum((point - positions) * directions, axis=1)
    return point if np.median(depths) > 0 else None


def mean_direction(directions: np.ndarray) -> np.ndarray | None:
    """Mean of the unit vectors `directions` (C, 3), normalised (3,); None if it is shorter than the bound above."""
    mean = directions.mean(axis=0)
    length = np.linalg.norm(mean)
    return mean / length if length > SMALLEST_MEAN_DIRECTION else None
