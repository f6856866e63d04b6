"""Ill-conditioned scenes: families of one parameter (and a seed), all changes of one base scene.

`cases.py` names parameter values, and the tests search over them at random. Gaussians are float64 with values that
float32 represents exactly: the error of a case is that of the arithmetic alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from rasterizer import Camera, Gaussians, Request
from rasterizer.reference.render import slice_in_time
from rasterizer.trajectories import Trajectories

Scene = tuple[Gaussians, Request]
COUNT = 24  # Gaussians, where they are not the parameter
OUTPUTS = ("color", "alpha", "depth", "flow", "stats")
DISTANCE = 3.0  # from the camera to the middle of the scene, world units


def generator(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def uniform(shape: Sequence[int], low: float, high: float, rng: torch.Generator) -> Tensor:
    return low + (high - low) * torch.rand(shape, generator=rng, dtype=torch.float64)


def camera_at(
    distance: float,
    width: int = 32,
    height: int = 24,
    focal: float = 30.0,
    target: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0),
) -> Camera:
    """A camera at `distance` from `target` that faces it, with no axis parallel to the world's; focal in pixels."""
    away = np.array([0.2, -0.35, -1.0])
    forward = -away / np.linalg.norm(away)
    right = np.cross([0.1, 1.0, 0.2], forward)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = [right, np.cross(forward, right), forward]
    pose[:3, 3] = -pose[:3, :3] @ (np.asarray(target) - distance * forward)
    return Camera(width, height, focal, focal * 1.1, 0.48 * width, 0.53 * height, pose)


def base_gaussians(count: int, seed: int, sh_degree: int = 3, fourier_order: int = 2) -> Gaussians:
    """Slow Gaussians of scale 0.05 to 0.25 in the cube [-0.8, 0.8]³, at times about [0, 1]; float64."""
    rng = generator(seed)
    normal = lambda *shape: torch.randn(shape, generator=rng, dtype=torch.float64)  # noqa: E731
    mean = torch.cat([uniform((count, 3), -0.8, 0.8, rng), uniform((count, 1), 0.2, 0.8, rng)], dim=1)
    scale = torch.cat([uniform((count, 3), -3.0, -1.4, rng), uniform((count, 1), -1.5, -0.5, rng)], dim=1)
    left = normal(count, 4)
    right = left * torch.tensor([1, -1, -1, -1]) + 0.2 * normal(count, 4)
    sh = 0.15 * normal(count, fourier_order + 1, (sh_degree + 1) ** 2, 3)
    sh[:, 0, 0] = normal(count, 3).abs()
    return Gaussians(mean, scale, left, right, uniform((count,), -1.5, 2.0, rng), sh.flatten(1, 2))


def base_request(**changes) -> Request:
    """All outputs at the middle of a duration of 1; flow over 0.01."""
    request = Request(camera_at(DISTANCE), time=0.5, background=(0.2, 0.4, 0.1), outputs=OUTPUTS, flow_dt=0.01)
    return replace(request, **changes)


def quaternion_product(a: Tensor, b: Tensor) -> Tensor:
    """Hamilton's a b of quaternions (…, 4), w first."""
    (aw, ax, ay, az), (bw, bx, by, bz) = a.unbind(-1), b.unbind(-1)
    return torch.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        dim=-1,
    )


def moving_quaternions(speed: Tensor, space: Tensor) -> tuple[Tensor, Tensor]:
    """(ql, qr), (N, 4) each: a rotation from x towards t by θ = atan(1/speed), then a rotation of space by `space`.

    A Gaussian that is long in x and short in time then moves at about `speed` (N,). The rotation v → l v r of
    v = x + yi + zj + tk keeps the time axis when l k r = k, that is r = -k l* k.
    """
    half = 0.5 * torch.atan2(torch.ones_like(speed), speed)
    zero = torch.zeros_like(half)
    tilt = torch.stack([half.cos(), zero, zero, half.sin()], dim=-1)
    left = space / space.norm(dim=-1, keepdim=True)
    k = left.new_tensor([0, 0, 0, 1])
    right = -quaternion_product(quaternion_product(k, left * left.new_tensor([1, -1, -1, -1])), k)
    return quaternion_product(left, tilt), quaternion_product(tilt, right)


def with_log_scale(gaussians: Gaussians, *scales: float | None) -> Gaussians:
    """The Gaussians with these standard deviations (x, y, z in world units, then time); None keeps one."""
    log_scale = gaussians.log_scale.clone()
    for axis, scale in enumerate(scales):
        if scale is not None:
            log_scale[:, axis] = math.log(scale)
    return replace(gaussians, log_scale=log_scale)


def with_mean(gaussians: Gaussians, space: Tensor | None = None, time: Tensor | None = None) -> Gaussians:
    """The Gaussians at positions `space` (N, 3), world units, and times `time` (N,); None keeps them."""
    mean = gaussians.mean.clone()
    if space is not None:
        mean[:, :3] = space
    if time is not None:
        mean[:, 3] = time
    return replace(gaussians, mean=mean)


@dataclass(frozen=True)
class Family:
    """A builder with the meaning of its parameter and the range of the search (logarithmic where low > 0)."""

    build: Callable[[float, int], Scene]
    low: float
    high: float
    parameter: str


FAMILIES: dict[str, Family] = {}


def family(low: float, high: float, parameter: str) -> Callable[[Callable], Callable]:
    """Registers a builder under its name, with its scene rounded to float32."""

    def register(build: Callable[[float, int], Scene]) -> Callable[[float, int], Scene]:
        def rounded(value: float, seed: int = 0) -> Scene:
            gaussians, request = build(value, seed)
            return gaussians.to(torch.float32).to(torch.float64), request

        FAMILIES[build.__name__] = Family(rounded, low, high, parameter)
        return rounded

    return register


# ---- Shape ----


@family(1, 1e8, "axis ratio, the long axis 0.4")
def needle(ratio: float, seed: int) -> Scene:
    return with_log_scale(base_gaussians(COUNT, seed), 0.4, 0.4 / ratio, 0.4 / ratio), base_request()


@family(1, 1e8, "axis ratio, the long axes 0.4")
def pancake(ratio: float, seed: int) -> Scene:
    return with_log_scale(base_gaussians(COUNT, seed), 0.4, 0.4, 0.4 / ratio), base_request()


@family(1, 1e8, "axis ratio, the short axes 1e-3 or less, the long one up to 1e4")
def long_needle(ratio: float, seed: int) -> Scene:
    """Longer than the scene above a ratio of 400, up to ten thousand times."""
    long = 0.4 * ratio**0.55
    return with_log_scale(base_gaussians(COUNT, seed), long, long / ratio, long / ratio), base_request()


@family(1e-3, 1e7, "standard deviation, world units, all three axes")
def size(scale: float, seed: int) -> Scene:
    return with_log_scale(base_gaussians(COUNT, seed), scale, scale, scale), base_request()


@family(1e-40, 1e37, "length of the quaternions")
def quaternion_length(length: float, seed: int) -> Scene:
    gaussians = base_gaussians(COUNT, seed)
    quaternions = {name: tensor for name, tensor in gaussians.tensors().items() if name.startswith("quat")}
    scaled = {name: q / q.norm(dim=-1, keepdim=True) * length for name, q in quaternions.items()}
    return replace(gaussians, **scaled), base_request()


@family(0, 2, "0: both quaternions zero, 1: the left one, 2: the left one antipodal to its neighbour's")
def quaternion_sign(which: float, seed: int) -> Scene:
    gaussians = base_gaussians(COUNT, seed).tensors()
    left, right = gaussians["quat_left"], gaussians["quat_right"]
    if which < 1.5:
        left.zero_()
    else:
        left[1::2], right[1::2] = -left[::2], right[::2]
    if which < 0.5:
        right.zero_()
    return Gaussians.from_tensors(gaussians), base_request()


# ---- Time ----


@family(1e-3, 1e6, "speed, world units a duration")
def velocity(speed: float, seed: int) -> Scene:
    gaussians, rng = base_gaussians(COUNT, seed), generator(seed + 1)
    speeds = torch.full((COUNT,), max(speed, 1e-9), dtype=torch.float64)
    left, right = moving_quaternions(speeds, torch.randn((COUNT, 4), generator=rng, dtype=torch.float64))
    theta = math.atan2(1, speed)
    short = 0.1 * math.sin(theta) * 0.4  # short in time, so that the rotation alone gives the temporal extent
    lifetime = math.sin(theta) * 0.4
    gaussians = replace(with_log_scale(gaussians, 0.4, 0.05, 0.05, short), quat_left=left, quat_right=right)
    return with_mean(gaussians, time=0.5 + lifetime * uniform((COUNT,), -1.5, 1.5, rng)), base_request()


@family(1e-3, 1e6, "speed that is a parameter, world units a duration; no rotation into time")
def trained_velocity(speed: float, seed: int) -> Scene:
    """Lifetimes are short enough that a Gaussian moves by its own size in one."""
    gaussians, rng = base_gaussians(COUNT, seed), generator(seed + 1)
    lifetime = 0.4 / max(speed, 1.0)
    direction = torch.randn((COUNT, 3), generator=rng, dtype=torch.float64)
    velocity = speed * direction / direction.norm(dim=1, keepdim=True)
    gaussians = replace(with_log_scale(gaussians, None, None, None, lifetime), quat_right=None, velocity=velocity)
    return with_mean(gaussians, time=0.5 + lifetime * uniform((COUNT,), -1.5, 1.5, rng)), base_request()


@family(1e-8, 1e6, "standard deviation in time, durations")
def time_scale(st: float, seed: int) -> Scene:
    """At the time of the view the Gaussians are where those of the base scene are at theirs."""
    gaussians = with_log_scale(base_gaussians(COUNT, seed), None, None, None, st)
    gaussians = with_mean(gaussians, time=st * uniform((COUNT,), -1.5, 1.5, generator(seed + 1)))
    moved = slice_in_time(gaussians, 0.0).mean - gaussians.mean[:, :3]
    return with_mean(gaussians, gaussians.mean[:, :3] - moved), base_request(time=0.0)


@family(1e-8, 1e6, "standard deviation in time, durations; no motion")
def time_scale_separable(st: float, seed: int) -> Scene:
    gaussians, request = time_scale(st, seed)
    return replace(gaussians, quat_right=None), request


@family(0.9, 1.1, "(t - μt) in units of where p(t) = 0.05")
def cut_off(part: float, seed: int) -> Scene:
    gaussians = replace(base_gaussians(COUNT, seed), quat_right=None)
    reach = math.sqrt(-2 * math.log(0.05)) * gaussians.log_scale[:, 3].exp()
    side = torch.where(torch.arange(COUNT) % 2 == 0, 1.0, -1.0)
    return with_mean(gaussians, time=0.5 - side * part * reach), base_request()


@family(1, 1e9, "t, durations after the video")
def outside_the_video(time: float, seed: int) -> Scene:
    return base_gaussians(COUNT, seed), base_request(time=time)


@family(1e-3, 1e5, "duration, seconds, times about 1e9 s")
def epoch(duration: float, seed: int) -> Scene:
    """The float32 spacing of times about 1e9 s is 64 s: shorter-lived Gaussians are at the rounded time."""
    gaussians, start = base_gaussians(COUNT, seed), 1_000_000_000.3
    gaussians = with_mean(gaussians, time=start + duration * gaussians.mean[:, 3])
    log_scale = gaussians.log_scale.clone()
    log_scale[:, 3] += math.log(max(duration, 100.0))
    slow = gaussians.quat_left * torch.tensor([1, -1, -1, -1])  # R keeps the time axis: the velocity is 0
    gaussians = replace(gaussians, log_scale=log_scale, quat_right=_keeping_time(gaussians.quat_left, slow))
    return gaussians, base_request(time=start + 0.5 * duration, duration=duration)


def _keeping_time(left: torch.Tensor, fallback: torch.Tensor) -> torch.Tensor:
    _, right = moving_quaternions(torch.full((len(left),), 1e30, dtype=left.dtype), left)
    return torch.where(torch.isfinite(right), right, fallback)


# ---- Shared trajectories ----


def sharing(gaussians: Gaussians, seed: int, displacement: float, angle: float) -> Gaussians:
    """All Gaussians on two trajectories that change by about `displacement`, world units, and `angle`, radians."""
    rng, still = generator(seed + 2), Trajectories.still(2, 8, (0.0, 1.0))
    size = torch.tensor([displacement] * 3 + [angle] * 3, dtype=torch.float64)
    points = size * torch.randn(still.control_points.shape, generator=rng, dtype=torch.float64)
    weights = uniform((len(gaussians), 2), 0.2, 1.0, rng)
    return replace(gaussians, quat_right=None, weights=weights, trajectories=Trajectories(points))


@family(1e-3, 1e2, "displacement along shared trajectories, world units, to where the base scene is")
def shared_displacement(displacement: float, seed: int) -> Scene:
    gaussians, request = sharing(base_gaussians(COUNT, seed), seed, displacement, 0.3), base_request()
    assert gaussians.weights is not None and gaussians.trajectories is not None
    moved = gaussians.weights @ gaussians.trajectories.values(request.time)[:, :3]
    return with_mean(gaussians, space=gaussians.mean[:, :3] - moved), request


@family(1e-3, 3e2, "angle that shared trajectories turn Gaussians by, radians")
def shared_rotation(angle: float, seed: int) -> Scene:
    return sharing(base_gaussians(COUNT, seed), seed, 0.05, angle), base_request()


@family(1e-6, 1e6, "t beyond the end of shared trajectories, durations; Gaussians do not fade")
def shared_end(beyond: float, seed: int) -> Scene:
    gaussians = with_log_scale(sharing(base_gaussians(COUNT, seed), seed, 0.05, 0.3), None, None, None, 1e7)
    return gaussians, base_request(time=1 + beyond)


# ---- Opacity ----


@family(-100, 100, "opacity logit")
def opacity(logit: float, seed: int) -> Scene:
    gaussians = base_gaussians(COUNT, seed)
    return replace(gaussians, opacity_logit=torch.full_like(gaussians.opacity_logit, logit)), base_request()


@family(-100, 100, "opacity logit of 1,000 Gaussians in a stack")
def stack(logit: float, seed: int) -> Scene:
    gaussians = base_gaussians(1000, seed, sh_degree=1, fourier_order=1)
    gaussians = replace(gaussians, opacity_logit=torch.full_like(gaussians.opacity_logit, logit))
    return gaussians, base_request(camera=camera_at(DISTANCE, 14, 10, 13.0))


# ---- Position ----


@family(-1, 1, "depth less the near plane, world units")
def near_plane(beyond: float, seed: int) -> Scene:
    """Half the Gaussians at this distance from the near plane, the others beyond them."""
    gaussians, request = base_gaussians(COUNT, seed), base_request()
    pose = request.camera.world_to_cam
    inside = (gaussians.mean[:, :3] * 0.1).clone()
    inside[:, 2] = request.near + beyond * torch.linspace(0.5, 1, COUNT, dtype=torch.float64)
    placed = (inside - torch.from_numpy(pose[:3, 3].copy())) @ torch.from_numpy(pose[:3, :3].copy())
    first = torch.arange(COUNT)[:, None] % 2 == 0
    now = torch.full((COUNT,), request.time, dtype=torch.float64)  # no displacement by velocity
    return with_mean(gaussians, space=torch.where(first, placed, gaussians.mean[:, :3]), time=now), request


@family(0, 0.1, "distance from the camera's centre, the near plane at 0")
def camera_centre(distance: float, seed: int) -> Scene:
    gaussians, request = base_gaussians(COUNT, seed), base_request(near=0.0)
    first = torch.arange(COUNT)[:, None] % 2 == 0
    centre = torch.from_numpy(request.camera.position) + distance * gaussians.mean[:, :3]
    now = torch.full((COUNT,), request.time, dtype=torch.float64)
    return with_mean(gaussians, space=torch.where(first, centre, gaussians.mean[:, :3]), time=now), request


@family(1e2, 1e7, "distance from the camera, world units; Gaussians scaled to the same image size")
def far(distance: float, seed: int) -> Scene:
    gaussians, request = scaled_scene(distance / DISTANCE, seed)
    return gaussians, replace(request, near=0.2)


@family(
    1e4, 1e7, "distance from the camera, world units, of Gaussians 0.005 apart in depth, scaled to the same image size"
)
def depth_gap(distance: float, seed: int) -> Scene:
    """The float32 spacing of depth is 1e-3 to 1 here. Means are near the origin, exact in float32, and static."""
    gaussians, request = far(distance, seed)
    forward = torch.from_numpy(request.camera.world_to_cam[2, :3].copy())
    place = torch.randperm(COUNT, generator=generator(seed + 1)) - COUNT / 2
    return with_mean(replace(gaussians, quat_right=None), space=0.005 * place[:, None] * forward), request


@family(2e4, 1e8, "focal length, pixels, of a camera at the distance where the base scene fills its image")
def telephoto(focal: float, seed: int) -> Scene:
    return base_gaussians(COUNT, seed), base_request(camera=camera_at(DISTANCE * focal / 30, focal=focal))


@family(1e2, 1e7, "distance of scene and camera from the world's origin; the scene has 1e-4 of its size")
def far_from_the_origin(distance: float, seed: int) -> Scene:
    scale, target = 1e-4 * distance, distance * np.array([0.6, -0.5, 0.62])
    gaussians, request = scaled_scene(scale, seed)
    camera = camera_at(DISTANCE * scale, target=target)
    return with_mean(gaussians, space=gaussians.mean[:, :3] + torch.from_numpy(target)), replace(request, camera=camera)


@family(1e-4, 1e4, "factor on the base scene and the near plane")
def scaled_scene(scale: float, seed: int) -> Scene:
    gaussians = base_gaussians(COUNT, seed)
    log_scale = gaussians.log_scale.clone()
    log_scale[:, :3] += math.log(scale)
    # Scaling space alone would change a rotation that mixes space and time, so the time axis is kept.
    gaussians = replace(
        with_mean(gaussians, space=gaussians.mean[:, :3] * scale),
        log_scale=log_scale,
        quat_right=_keeping_time(gaussians.quat_left, gaussians.quat_left),
    )
    return gaussians, base_request(camera=camera_at(DISTANCE * scale), near=0.2 * scale)


# ---- Counts and image sizes ----


@family(1, 10_000, "number of exactly coincident Gaussians")
def coincident(count: float, seed: int) -> Scene:
    gaussians = base_gaussians(round(count), seed, sh_degree=0, fourier_order=0)
    one = {name: getattr(gaussians, name)[:1] for name in ("mean", "log_scale", "quat_left", "quat_right")}
    one["mean"] = one["mean"] * 0.2
    gaussians = replace(gaussians, **{name: t.repeat(len(gaussians), 1) for name, t in one.items()})
    gaussians = with_mean(gaussians, time=torch.full((len(gaussians),), 0.5, dtype=torch.float64))
    camera = camera_at(DISTANCE, *((9, 7, 9.0) if count > 100 else (32, 24, 30.0)))
    return gaussians, base_request(camera=camera)


@family(10, 1e5, "number of Gaussians on one pixel, of different depths")
def one_pixel(count: float, seed: int) -> Scene:
    """On the optical axis, each as large in the image, rows in no order of depth."""
    number = round(count)
    gaussians, camera = base_gaussians(number, seed, sh_degree=0, fourier_order=0), camera_at(DISTANCE, 5, 3, 4.0)
    pose = torch.from_numpy(camera.world_to_cam.copy())
    depth = 2.0 + 5.0 * (torch.randperm(number, generator=generator(seed + 1)) + 0.5) / number
    space = depth[:, None] * pose[2, :3] + torch.from_numpy(camera.position)
    size = torch.log(depth[:, None] * torch.tensor([0.2, 0.15, 0.1], dtype=torch.float64))
    gaussians = replace(
        gaussians,
        quat_left=gaussians.quat_left[:1].repeat(number, 1),
        log_scale=torch.cat([size, gaussians.log_scale[:, 3:]], dim=1),
        opacity_logit=torch.full((number,), -1.0, dtype=torch.float64),
        quat_right=None,
    )
    now = torch.full((number,), 0.5, dtype=torch.float64)
    return with_mean(gaussians, space=space, time=now), base_request(camera=camera)


@family(0, 40, "number of Gaussians")
def count(number: float, seed: int) -> Scene:
    return base_gaussians(round(number), seed), base_request()


@family(1, 8192, "columns of an image of one row")
def wide(columns: float, seed: int) -> Scene:
    camera = camera_at(DISTANCE, round(columns), 1, max(1.0, 0.9 * round(columns)))
    return base_gaussians(COUNT, seed), base_request(camera=camera)


@family(1, 8192, "rows of an image of one column")
def tall(rows: float, seed: int) -> Scene:
    camera = camera_at(DISTANCE, 1, round(rows), max(1.0, 0.9 * round(rows)))
    return base_gaussians(COUNT, seed), base_request(camera=camera)
