"""Pictures of a test view: render, ground truth and difference; what moves; depth and flow beside their truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from datasets.files.atomic_write import atomic_file
from datasets.ground_truth import GroundTruth
from datasets.scene import Scene
from pipeline.evaluation.image_metrics import Geometry
from pipeline.evaluation.metrics import MeasuredView, SeeView
from pipeline.evaluation.pictures.false_colour import depth_picture, depth_range, error_picture, flow_picture

DIFFERENCE_GAIN = 4  # brightness of a difference image relative to |render - truth|, clipped at white
LARGEST_DEPTH_ERROR = 0.2  # relative; brightest in the picture
LONGEST_QUANTILE = 0.98  # of the true flows that are not zero: the full colour
DRIVE_DEPTHS = (4.0, 80.0)  # metres: nearest and farthest colour of a driving log's depth
GAP = 4  # pixels between the parts
COMPRESSION = 3  # of PNG: half the time of the default, 6, for a tenth more bytes


def picture_saver(folder: Path, scene: Scene) -> SeeView:
    """A function that writes what is known of a view into `folder`; slashes in its name become _.

    <view>_render.png, <view>_truth.png and <view>_difference.png, |render - truth| × DIFFERENCE_GAIN, clipped.
    <view>_moving.png: white what moves. <view>_depth.png and <view>_flow.png: render, truth and error side by side.
    <view>_rendered_depth.png: of a driving log, whose views have one range of colours.
    """
    folder.mkdir(exist_ok=True)

    def save(name: str, seen: MeasuredView) -> None:
        stem, known, found = name.replace("/", "_"), seen.known, seen.geometry
        pictures = {
            "render": [seen.image],
            "truth": [seen.truth],
            "difference": [np.abs(seen.image - seen.truth) * DIFFERENCE_GAIN],
        }
        if found is not None and known is not None and known.depth is not None:
            pictures["depth"] = depth_parts(found.depth, known.depth)
        if found is not None and known is not None and known.flow is not None and found.flow is not None:
            pictures["flow"] = flow_parts(found, known)
        if found is not None and scene.capture == "drive":
            near, far = (metres * seen.metre for metres in DRIVE_DEPTHS)
            pictures["rendered_depth"] = [depth_picture(found.depth, near, far)]
        for kind, parts in pictures.items():
            save_picture(folder / f"{stem}_{kind}.png", parts)
        if seen.dynamic is not None:
            with atomic_file(folder / f"{stem}_moving.png") as temporary:
                Image.fromarray(seen.dynamic).save(temporary)

    return save


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
        Image.fromarray(np.round(np.clip(row, 0.0, 1.0) * 255.0).astype(np.uint8)).save(
            temporary, compress_level=COMPRESSION
        )
