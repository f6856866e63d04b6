"""Canonical coordinates: one place for the origin, one unit of length and one of time for every scene.

What training does depends on units: rotations in 4D mix space with time, the time of a Gaussian is learned at a rate
per unit of time, random points start in a cube round the origin, and float32 has few digits left far from it. So a
scene is brought into canonical coordinates before anything is made of it, and a world in millimetres or far from its
origin, or a film in frames or since 1970, gives what the same one gives in any other unit:

    canonical x = (x - centre) scale        canonical t = (t - time_origin) time_scale

Space: the origin is where the training cameras look, 4 units from them in the mean: so D-NeRF's scenes are made, and
so the released program's converter turns others. Time: photographs take [0, 1], D-NeRF's convention; of a film 30
frames are a unit, so that 30 a second, as Plenoptic Video's, are seconds. The world is not turned.

What obeys the convention to a tenth is left exactly as it is. Two scalings of one world that both do are not made
equal, therefore: they differ by a tenth at most.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from datasets.cameras.optical_axes import axes_meet, mean_direction
from datasets.scene import Box, Scene, View, camera_extent
from rasterizer.camera import Camera

DISTANCE = 4.0  # of the training cameras from the origin, mean
FRAMES_A_UNIT = 30.0  # of a film
TOLERANCE = 0.1  # in parts of DISTANCE: a scene whose origin and cameras are so near to the convention obeys it
# Relative. A rate told from times in float64 is 30 but for their rounding, which after 1970 in seconds is 2e-7.
RATE_ROUNDING = 1e-9


@dataclass(frozen=True)
class Canonical:
    """How a scene's own coordinates become canonical ones. As it stands: the identity."""

    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)  # world units
    scale: float = 1.0  # canonical units of a world unit
    time_origin: float = 0.0  # the scene's time unit; of a film since the first frame in use
    time_scale: float = 1.0  # canonical units of a unit of the scene's time

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
        """World units of one canonical unit."""
        return 1.0 / self.scale

    @property
    def inverse(self) -> Canonical:
        """From canonical coordinates back to the scene's own, by the same functions."""
        return Canonical(
            tuple(-self.scale * x for x in self.centre),
            1.0 / self.scale,
            -self.time_scale * self.time_origin,
            1.0 / self.time_scale,
        )

    def points(self, world: np.ndarray) -> np.ndarray:
        """(…, 3) world -> (…, 3) canonical, float64."""
        return (np.asarray(world, dtype=np.float64) - self.centre) * self.scale

    def time(self, own: float) -> float:
        return (own - self.time_origin) * self.time_scale

    def camera(self, camera: Camera) -> Camera:
        """The camera that sees at canonical points what `camera` sees at the world's; its depths are × scale."""
        pose = camera.world_to_cam.copy()
        pose[:3, 3] = self.scale * (pose[:3, :3] @ self.centre + pose[:3, 3])
        return replace(camera, world_to_cam=pose)

    def box(self, world: Box) -> Box:
        """A box as Scene.init_box, world -> canonical; the very same where space stays as it is."""
        if self.keeps_space:
            return world
        return tuple(tuple(self.points(np.broadcast_to(corner, 3)).tolist()) for corner in world)

    def described(self) -> dict:
        """For canonical.json: the numbers, and what they mean."""
        return {
            **asdict(self),
            "meaning": "canonical x = (x - centre) scale, canonical t = (t - time_origin) time_scale; a "
            "film's t counts from its first frame in use",
        }

    def __str__(self) -> str:
        """What changes, in one line."""
        parts, centre = [], ", ".join(f"{x:.6g}" for x in self.centre)
        if not self.keeps_space:
            parts.append(f"x → (x - ({centre})) × {self.scale:.6g}")
        if not self.keeps_time:
            parts.append(f"t → (t - {self.time_origin:.15g}) × {self.time_scale:.6g}")
        return ", ".join(parts) or "as it is"


def canonical_of(scene: Scene) -> Canonical:
    """Follows from the scene's training cameras, its range of time and, where it was filmed, its rate."""
    space = canonical_space([view.camera for view in scene.train], scene.unit)
    if scene.frame_rate is None:
        time_scale = 1.0 / scene.duration
    else:
        time_scale = scene.frame_rate / FRAMES_A_UNIT
        if abs(time_scale - 1.0) < RATE_ROUNDING:
            time_scale = 1.0
    return replace(space, time_origin=float(scene.time_start), time_scale=float(time_scale))


def canonical_space(cameras: Sequence[Camera], unit: float | None = None) -> Canonical:
    """The part of space, from training cameras (each may come often and counts once); time stays as it is.

    The centre is the point nearest to all optical axes, by least squares. Axes that are almost parallel, or part
    from each other, do not tell it. Then `unit`, in world units, is taken for the canonical one, and the centre lies
    DISTANCE units ahead of the mean camera; of cameras that look all around, it is where they stand. unit: what the
    scene is normalised by otherwise (Scene.unit: the nearest bound, where the data has bounds); None: 3DGS's extent
    of the cameras. All of these shift and scale with the world, hence so does the result.
    """
    cameras = list({camera.world_to_cam.tobytes(): camera for camera in cameras}.values())
    positions = np.stack([camera.position for camera in cameras])
    directions = np.stack([camera.world_to_cam[2, :3] for camera in cameras])
    middle = positions.mean(axis=0)
    around = positions - middle  # what follows has all its digits, wherever the origin is
    centre = axes_meet(around, directions)
    if centre is not None:
        unit = float(np.linalg.norm(around - centre, axis=1).mean()) / DISTANCE
    else:
        unit = unit or camera_extent(cameras) or 1.0  # cameras all in one place are refused elsewhere
        ahead = mean_direction(directions)
        centre = np.zeros(3) if ahead is None else DISTANCE * unit * ahead
    centre = middle + centre
    if abs(unit - 1.0) <= TOLERANCE and np.linalg.norm(centre) <= TOLERANCE * DISTANCE:
        return Canonical()
    return Canonical(tuple(centre.tolist()), 1.0 / unit)


def canonicalise(scene: Scene, frame: Canonical) -> Scene:
    """The same scene in canonical coordinates: all that has a length or a time in it. The identity gives it itself."""
    if frame.is_identity:
        return scene
    moved: dict[int, Camera] = {}  # by id: the frames of a film share their camera

    def view_of(view: View) -> View:
        key = id(view.camera)
        if key not in moved:
            moved[key] = frame.camera(view.camera)
        return replace(view, camera=moved[key], time=frame.time(view.time))

    return replace(
        scene,
        train=tuple(map(view_of, scene.train)),
        test=tuple(map(view_of, scene.test)),
        duration=scene.duration * frame.time_scale,
        time_start=frame.time(scene.time_start),
        extent=scene.extent * frame.scale,
        init_box=frame.box(scene.init_box),
        unit=scene.unit * frame.scale,
        frame_rate=None if scene.frame_rate is None else scene.frame_rate / frame.time_scale,
    )
