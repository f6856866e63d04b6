"""Sky masks of images whose data have none, without learned weights: from brightness, colour, edges and LiDAR.

Sky is bright, not reddish, smooth, above every LiDAR return of its column, and connected with the image's upper edge.
How bright is found for each image: by Otsu's threshold between the bright and the dark of what lies above the LiDAR.
The rules are for daylight, and cautious: patches of sky between leaves are left out, because what is wrongly called
sky is carved out of the scene, and what is wrongly not is learned from the images anyway.
"""

from __future__ import annotations

import cv2
import numpy as np

LEAST_BRIGHT = 100.0  # levels of 255, of the brightest channel
LEAST_CONTRAST = 40.0  # levels between the means of bright and dark; below it all above the LiDAR is of one kind
REDDISH = 8.0  # levels by which red may exceed blue
EDGE = 8.0  # levels a pixel: gradients above belong to things
TOP = 0.02  # of the height: rows at the upper edge
LEAST_SHARE = 0.002  # of the image: smaller patches are no sky
NEIGHBOURS = 2  # columns on either side whose LiDAR returns count too


def estimate_sky(image: np.ndarray, depth: np.ndarray | None = None) -> np.ndarray:
    """(H, W) bool of an image (H, W, 3) uint8. depth: (H, W) of LiDAR points, 0 where there is none; None: no LiDAR."""
    height, width = image.shape[:2]
    lowest = np.full(width, height) if depth is None else _highest_return(depth)
    allowed = np.arange(height)[:, None] < lowest
    if not allowed.any():
        return allowed
    smooth = cv2.GaussianBlur(image, (3, 3), 0).astype(np.float32)
    brightness = smooth.max(axis=2)
    bright = allowed & (brightness > max(LEAST_BRIGHT, _otsu(brightness[allowed])))
    bright &= smooth[..., 0] - smooth[..., 2] <= REDDISH
    gradient = np.hypot(cv2.Sobel(brightness, cv2.CV_32F, 1, 0), cv2.Sobel(brightness, cv2.CV_32F, 0, 1)) / 4
    patches, groups, boxes, _ = cv2.connectedComponentsWithStats((bright & (gradient < EDGE)).astype(np.uint8))
    at_top = boxes[:, cv2.CC_STAT_TOP] < max(1.0, TOP * height)
    large = boxes[:, cv2.CC_STAT_AREA] >= LEAST_SHARE * height * width
    chosen = at_top & large & (np.arange(patches) > 0)
    # The edge itself, where the gradient is large on either side of it.
    return cv2.dilate(chosen[groups].astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool) & bright


def _highest_return(depth: np.ndarray) -> np.ndarray:
    """(W,) the row of each column's highest LiDAR point, its neighbours' included; H without any."""
    hit = depth > 0
    top = np.where(hit.any(axis=0), hit.argmax(axis=0), len(depth)).astype(np.float32)
    return cv2.erode(top[None], np.ones((1, 2 * NEIGHBOURS + 1), np.uint8))[0].astype(int)


def _otsu(values: np.ndarray) -> float:
    """Otsu's threshold of values in [0, 255]; -1, below all, where they are of one kind."""
    threshold, _ = cv2.threshold(values.astype(np.uint8)[None], 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    above = values > threshold
    if not above.any() or above.all() or values[above].mean() - values[~above].mean() < LEAST_CONTRAST:
        return -1.0
    return float(threshold)
