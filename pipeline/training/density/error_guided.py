"""Error-guided densification: new Gaussians where and when the model is wrong.

Densification clones and splits Gaussians that exist. An object that is visible for a short time may have none: those
that start there live longer than the object, are wrong most of the time and become transparent. So candidates are
drawn along the rays of pixels with a large error, at the time of the image. In the right place the error is large in
the neighbouring images too: those of the other cameras at this time, or of the one camera just before and after.
A candidate's score is a low quantile of the errors at its projections, and the best become short-lived Gaussians.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import uniform_filter
from torch import Tensor

from datasets.scene import Scene, View
from pipeline.config.random_streams import Stream, stream
from pipeline.config.schema import Config
from pipeline.data.training_views import Target, target_of
from pipeline.model.initialise import SH_C0
from pipeline.model.model import Model
from pipeline.model.render import render_each
from pipeline.training.schedule import Phase
from pipeline.training.state import TrainState
from rasterizer import Request

IMAGE_SIDE = 100  # pixels of the longer side at which errors are measured: objects, not texture
MOST_ADDED = 2000  # each time
MAX_VIEWS = 200  # rendered each time; of more, the windows of random times
CANDIDATES = 10  # for each new Gaussian
SEVERAL_CAMERAS = 3  # as many views of one time need no neighbouring times
WINDOW = 5  # times, the candidate's in the middle, where fewer cameras see each time
FEWEST_VIEWS = 3  # a candidate in fewer images is not scored
QUANTILE = 0.25  # of the errors at a candidate's projections: it may be hidden in some
MIN_ERROR = 0.02  # mean absolute error over the channels, data range 1
TEMPORAL_SCALE = 1.5  # σt of a new Gaussian, in frame spacings
RADIUS = 2.0  # spatial σ, in pixels of the images whose errors are measured
OPACITY = 0.1  # as at the start


class ErrorGuidedDensification:
    """After pruning, which makes room below max_gaussians and would remove most of the new ones at once."""

    event = "add_by_error"

    def __init__(self, scene: Scene, cfg: Config) -> None:
        self._rules, self._seed = cfg.train.densify, cfg.seed
        self._sampler = ErrorSampler(scene, cfg.scene.near * scene.unit, cfg.backend)

    def due(self, iteration: int, clock: float) -> bool:
        rules = self._rules
        wanted = rules.add_by_error > 0 and iteration % rules.add_by_error_every == 0
        return wanted and iteration >= rules.start and clock < rules.stop

    def apply(self, state: TrainState, phase: Phase) -> dict[str, int]:
        """Add as many Gaussians as the three limits of their number allow."""
        rules, sphere = self._rules, state.model.sphere
        present = len(state.model) if sphere is None else int((~sphere).sum())
        limits = (MOST_ADDED, int(rules.add_by_error * present), rules.max_gaussians - present)
        count, rows = min(limits), None
        if count > 0 and state.model.kind.dims == 4:
            rng = stream(self._seed, Stream.ERROR_POINTS, state.iteration)
            rows = self._sampler.draw(state.model, count, rng, state.threads)
        if rows is None:
            return {"added": 0}
        state.optimiser.append(rows)
        state.reset_statistics()
        return {"added": len(rows["mean"])}


@dataclass(frozen=True)
class Candidates:
    """Points in space and time, and how wrong the model is there."""

    position: np.ndarray  # (M, 3) world units
    time: np.ndarray  # (M,) the scene's unit, of a training view
    score: np.ndarray  # (M,) quantile of the errors at the projections; 0 in too few images
    color: np.ndarray  # (M, 3) median over the projections, in [0, 1]
    sigma: np.ndarray  # (M,) world units: RADIUS pixels at this distance


class ErrorSampler:
    """Draws new Gaussians for a scene; keeps its reduced training images between calls."""

    def __init__(self, scene: Scene, near: float, backend: str = "cpu") -> None:
        """near: the near plane, world units."""
        self._scene, self._near, self._backend = scene, near, backend
        self._targets: dict[int, Target] = {}
        self._views: dict[float, list[int]] = defaultdict(list)  # of each time
        for index, view in enumerate(scene.train):
            self._views[view.time].append(index)

    def draw(self, model: Model, count: int, rng: np.random.Generator, threads: int) -> dict[str, Tensor] | None:
        """Rows of at most `count` new Gaussians, of the fields of `model`; None where the model is nowhere wrong."""
        windows = self._windows(rng)
        chosen = sorted({index for window in windows.values() for index in window})
        errors = self._errors(model, chosen, threads)
        candidates = self._candidates(windows, chosen, errors, CANDIDATES * count, rng)
        if candidates is None:
            return None
        weight = np.square(np.maximum(candidates.score - MIN_ERROR, 0.0))
        found = min(count, int((weight > 0).sum()))
        if found == 0:
            return None
        best = np.sort(rng.choice(len(weight), found, replace=False, p=weight / weight.sum()))
        rows = _rows(model, candidates, best, TEMPORAL_SCALE * self._scene.frame_spacing)
        return {name: tensor.to(model.device) for name, tensor in rows.items()}

    def _windows(self, rng: np.random.Generator) -> dict[float, list[int]]:
        """Time -> the training views that a candidate of that time is scored in; together at most about MAX_VIEWS."""
        times = sorted(self._views)
        cameras = len(self._scene.train) / len(times)
        width = 1 if cameras >= SEVERAL_CAMERAS else min(WINDOW, len(times))
        if len(self._scene.train) <= MAX_VIEWS:
            middles = list(range(len(times)))
        else:
            middles = rng.choice(len(times), max(1, int(MAX_VIEWS / (cameras * width))), replace=False).tolist()
        windows = {}
        for middle in middles:
            first = min(max(middle - width // 2, 0), len(times) - width)
            windows[times[middle]] = [view for time in times[first : first + width] for view in self._views[time]]
        return windows

    def _target(self, index: int) -> Target:
        if index not in self._targets:
            if len(self._targets) >= 2 * MAX_VIEWS:  # a long video: other times each time
                self._targets.clear()
            self._targets[index] = reduced(self._scene.train[index])
        return self._targets[index]

    def _errors(self, model: Model, views: Sequence[int], threads: int) -> dict[int, np.ndarray]:
        """View -> (H, W) absolute error, mean over the channels and over 3 × 3 pixels."""
        scene, targets, found = self._scene, [self._target(index) for index in views], {}
        requests = [
            Request(target.camera, target.time, scene.duration, scene.background, near=self._near) for target in targets
        ]
        renders = render_each(self._backend, threads, model, requests, differentiable=False)
        for index, target, (_, rendered) in zip(views, targets, renders, strict=True):
            error = (rendered.image.cpu() - target.image).abs().mean(dim=0)
            if target.mask is not None:
                error = torch.where(target.mask, error, 0.0)
            found[index] = uniform_filter(error.numpy(), 3)
        return found

    def _candidates(
        self,
        windows: dict[float, list[int]],
        views: Sequence[int],
        errors: dict[int, np.ndarray],
        count: int,
        rng: np.random.Generator,
    ) -> Candidates | None:
        """About `count` candidates: rays by squared error, depths uniform inside the box of initial points."""
        squared = {index: np.square(errors[index]).ravel() for index in views if self._time(index) in windows}
        share = np.array([values.sum() for values in squared.values()], dtype=np.float64)
        if share.sum() == 0:
            return None
        found = []
        for index, number in zip(squared, rng.multinomial(count, share / share.sum())):
            if number == 0:
                continue
            points, depth = self._along_rays(index, squared[index], int(number), rng)
            score, color = self._scored(points, windows[self._time(index)], errors)
            sigma = RADIUS * depth / self._target(index).camera.fx
            found.append((points, np.full(len(points), self._time(index)), score, color, sigma))
        return Candidates(*(np.concatenate(column) for column in zip(*found)))

    def _time(self, index: int) -> float:
        return self._scene.train[index].time

    def _along_rays(
        self, index: int, weight: np.ndarray, count: int, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Points (n, 3) in the box and their depths (n,), n <= count, seen in pixels drawn by `weight` (H·W,)."""
        camera = self._target(index).camera
        cumulative = np.cumsum(weight, dtype=np.float64)
        pixel = np.searchsorted(cumulative, rng.random(count) * cumulative[-1]).clip(max=len(weight) - 1)
        row, column = np.divmod(pixel, camera.width)
        x, y = ((column, row) + rng.random((2, count)) - [[camera.cx], [camera.cy]]) / [[camera.fx], [camera.fy]]
        directions = np.stack([x, y, np.ones(count)], axis=1) @ camera.world_to_cam[:3, :3]
        with np.errstate(divide="ignore"):
            low, high = ((np.asarray(corner) - camera.position) / directions for corner in self._scene.init_box)
        first = np.maximum(np.minimum(low, high).max(axis=1), self._near)
        last = np.maximum(low, high).min(axis=1)
        inside = first < last
        depth = rng.uniform(first[inside], last[inside])
        return camera.position + depth[:, None] * directions[inside], depth

    def _scored(
        self, points: np.ndarray, views: Sequence[int], errors: dict[int, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Score (n,) and colour (n, 3) of points (n, 3) by their projections into `views`."""
        error = np.full((len(views), len(points)), np.nan, dtype=np.float32)
        color = np.full((len(views), len(points), 3), np.nan, dtype=np.float32)
        for row, index in enumerate(views):
            target = self._target(index)
            c = target.camera
            x, y, z = c.world_to_cam[:3, :3] @ points.T + c.world_to_cam[:3, 3:]
            with np.errstate(divide="ignore", invalid="ignore"):
                u, v = np.floor(c.fx * x / z + c.cx), np.floor(c.fy * y / z + c.cy)
            seen = (z > self._near) & (u >= 0) & (u < c.width) & (v >= 0) & (v < c.height)
            u, v = u[seen].astype(int), v[seen].astype(int)
            if target.mask is not None:
                valid = target.mask.numpy()[v, u]
                seen[seen], u, v = valid, u[valid], v[valid]
            error[row, seen] = errors[index][v, u]
            color[row, seen] = target.image.numpy()[:, v, u].T
        enough = np.isfinite(error).sum(axis=0) >= min(FEWEST_VIEWS, len(views))
        score, colors = np.zeros(len(points)), np.zeros((len(points), 3))
        score[enough] = quantile_of_known(error[:, enough], QUANTILE)
        colors[enough] = quantile_of_known(color[:, enough], 0.5)
        return score, colors


def reduced(view: View) -> Target:
    """The view at IMAGE_SIDE pixels of its longer side, or as it is."""
    return target_of(view, min(1.0, IMAGE_SIDE / max(view.camera.width, view.camera.height)))


def quantile_of_known(values: np.ndarray, quantile: float) -> np.ndarray:
    """np.nanquantile along the first axis, for columns with at least one number: that one calls Python for each."""
    values = np.sort(values, axis=0)  # NaN last
    place = quantile * (np.isfinite(values).sum(axis=0, keepdims=True) - 1)
    below = np.floor(place).astype(int)
    low, high = (np.take_along_axis(values, index, axis=0)[0] for index in (below, np.ceil(place).astype(int)))
    return low + (high - low) * (place - below)[0]


def _rows(model: Model, candidates: Candidates, chosen: np.ndarray, temporal_scale: float) -> dict[str, Tensor]:
    """Isotropic Gaussians without motion at the chosen candidates, of their colours at any time, in any direction."""
    rows = {name: torch.zeros(len(chosen), *p.shape[1:]) for name, p in model.parameters.items()}
    rows["mean"][:, :3] = torch.from_numpy(candidates.position[chosen])
    rows["mean"][:, 3] = torch.from_numpy(candidates.time[chosen])
    rows["log_scale"][:, :3] = torch.from_numpy(np.log(candidates.sigma[chosen]))[:, None]
    rows["log_scale"][:, 3] = float(np.log(temporal_scale))
    for name in ("quat_left", "quat_right"):
        if name in rows:
            rows[name][:, 0] = 1.0
    rows["opacity_logit"].fill_(float(np.log(OPACITY / (1 - OPACITY))))
    rows["sh"][:, 0] = torch.from_numpy((candidates.color[chosen] - 0.5) / SH_C0)
    return rows
