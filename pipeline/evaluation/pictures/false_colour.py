"""Pictures of numbers: depth, optical flow and errors as colours, (H, W, 3) float32 in [0, 1]."""

from __future__ import annotations

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import hsv_to_rgb

UNKNOWN = 0.0  # black: nothing is rendered there, or the truth is not known
DEPTH_QUANTILES = (0.02, 0.98)  # of known depths: the ends of their colours


def depth_range(depths: np.ndarray) -> tuple[float, float]:
    """(nearest, farthest) of the known ones of `depths` (any shape; 0: unknown), without outliers."""
    known = depths[(depths > 0) & np.isfinite(depths)]
    if not known.size:
        return 1.0, 2.0
    near, far = (float(value) for value in np.quantile(known, DEPTH_QUANTILES))
    return near, max(far, near * (1 + 1e-6))


def depth_picture(depth: np.ndarray, near: float, far: float) -> np.ndarray:
    """Inverse depth (H, W), yellow at `near` to dark blue at `far`; black where depth is 0."""
    inverse = 1.0 / np.maximum(depth, near * 1e-3)
    share = (inverse - 1.0 / far) / (1.0 / near - 1.0 / far)
    return _masked(colormaps["cividis"](np.clip(share, 0.0, 1.0))[..., :3], depth > 0)


def flow_picture(flow: np.ndarray, longest: float, known: np.ndarray | None = None) -> np.ndarray:
    """Flow (2, H, W): its direction as hue (right red, down yellow-green, left cyan, up violet), its length as
    saturation, full at `longest` pixels; white where nothing moves, black where not `known` (H, W)."""
    angle = np.arctan2(flow[1], flow[0]) / (2 * np.pi) % 1.0
    length = np.clip(np.hypot(*flow) / max(longest, 1e-9), 0.0, 1.0)
    return _masked(hsv_to_rgb(np.stack([angle, length, np.ones_like(length)], axis=-1)), known)


def error_picture(error: np.ndarray, largest: float, known: np.ndarray | None = None) -> np.ndarray:
    """Errors (H, W) >= 0, dark blue at 0 to yellow at `largest`; black where not `known`."""
    return _masked(colormaps["cividis"](np.clip(error / max(largest, 1e-9), 0.0, 1.0))[..., :3], known)


def value_picture(values: np.ndarray, low: float, high: float, known: np.ndarray | None = None) -> np.ndarray:
    """Values (H, W) between `low`, dark, and `high`, bright; black where not `known`."""
    share = (values - low) / max(high - low, 1e-9)
    return _masked(colormaps["viridis"](np.clip(share, 0.0, 1.0))[..., :3], known)


def _masked(picture: np.ndarray, known: np.ndarray | None) -> np.ndarray:
    picture = picture.astype(np.float32)
    return picture if known is None else np.where(known[..., None], picture, np.float32(UNKNOWN))
