"""Depth and flow of the test views beside their truth, and where they are wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from datasets.files.atomic_write import atomic_file
from datasets.ground_truth import GroundTruth
from pipeline.data.training_views import evenly_spaced, target_of
from pipeline.evaluation.image_metrics import Geometry
from pipeline.evaluation.moving_pixels import MovingPixels
from pipeline.evaluation.pictures.false_colour import depth_picture, depth_range, error_picture, flow_picture
from pipeline.evaluation.renderer import Renderer

LARGEST_DEPTH_ERROR = 0.2  # relative; brightest in the picture
LONGEST_QUANTILE = 0.98  # of the true flows that are not zero: the full colour
DRIVE_DEPTHS = (4.0, 80.0)  # metres: nearest and farthest colour of a driving log's depth
GAP = 4  # pixels between the parts


def write_geometry(folder: Path, renderer: Renderer) -> None:
    """<view>_depth.png and <view>_flow.png of the test views that `evaluate.renders` selects and whose truth is known:
    render, truth and error side by side."""
    scene, cfg = renderer.scene, renderer.cfg
    moving = MovingPixels(scene, cfg.train.resolution_scale)
    for index in evenly_spaced(len(scene.test), cfg.evaluate.renders):
        known = moving.truth_of(index)
        if known is None or (known.depth is None and known.flow is None):
            continue
        target = target_of(scene.test[index], cfg.train.resolution_scale)
        found = renderer.geometry(target.camera, target.time, known.flow_dt)
        name = target.name.replace("/", "_")
        if known.depth is not None:
            save_picture(folder / f"{name}_depth.png", depth_parts(found.depth, known.depth))
        if known.flow is not None and found.flow is not None:
            save_picture(folder / f"{name}_flow.png", flow_parts(found, known))


def write_rendered_depth(folder: Path, renderer: Renderer) -> None:
    """<view>_rendered_depth.png of a driving log's test views that `evaluate.renders` selects, of one view's size."""
    scene, cfg = renderer.scene, renderer.cfg
    near, far = (metres * (scene.metre or 1.0) for metres in DRIVE_DEPTHS)
    for index in evenly_spaced(len(scene.test), cfg.evaluate.renders):
        target = target_of(scene.test[index], cfg.train.resolution_scale)
        depth = renderer.geometry(target.camera, target.time, None).depth
        name = target.name.replace("/", "_")
        save_picture(folder / f"{name}_rendered_depth.png", [depth_picture(depth, near, far)])


def depth_parts(depth: np.ndarray, truth: np.ndarray) -> list[np.ndarray]:
    """Pictures of a depth (H, W), of the true one (0: unknown) and of |depth - truth| / truth."""
    near, far = depth_range(truth)
    error = np.abs(depth - truth) / np.where(truth > 0, truth, 1.0)
    return [
        depth_picture(depth, near, far),
        depth_picture(truth, near, far),
        error_picture(error, LARGEST_DEPTH_ERROR, truth > 0),
    ]


def flow_parts(found: Geometry, known: GroundTruth) -> list[np.ndarray]:
    """Pictures of a flow, of the true one and of their distance, brightest at the length of the longest true flows."""
    assert found.flow is not None and known.flow is not None and known.flow_valid is not None
    longest = longest_flow(known.flow, known.flow_valid)
    error = np.hypot(*(found.flow - known.flow))
    return [
        flow_picture(found.flow, longest),
        flow_picture(known.flow, longest, known.flow_valid),
        error_picture(error, longest, known.flow_valid),
    ]


def longest_flow(flow: np.ndarray, known: np.ndarray) -> float:
    """Pixels; at least a tenth of one, so that noise does not look like motion."""
    length = np.hypot(*flow)[known]
    length = length[length > 0]
    return max(0.1, float(np.quantile(length, LONGEST_QUANTILE))) if length.size else 0.1


def save_picture(path: Path, parts: list[np.ndarray]) -> None:
    """Images (H, W, 3) in [0, 1] side by side, with white gaps."""
    gap = np.ones((parts[0].shape[0], GAP, 3), np.float32)
    row = np.concatenate([piece for part in parts for piece in (part, gap)][:-1], axis=1)
    with atomic_file(path) as temporary:
        Image.fromarray(np.round(np.clip(row, 0.0, 1.0) * 255.0).astype(np.uint8)).save(temporary)
