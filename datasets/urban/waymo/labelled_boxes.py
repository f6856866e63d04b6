"""What moves, by the labelled boxes of a frame: a mask of each image."""

from __future__ import annotations

import cv2
import numpy as np

from rasterizer.camera import Camera

MOVING_SPEED = 1.0  # metres a second, of a box
MARGIN = 0.1  # of an image's sides, around it


def moving_boxes(
    boxes: list[np.ndarray], camera: Camera, vehicle_to_world: np.ndarray, distortion: tuple[float, ...]
) -> np.ndarray:
    """(H, W) bool: outlines of the boxes that move faster than MOVING_SPEED, in the distorted image.

    boxes: (9,) centre, size, heading in the vehicle's frame, velocity in x and y. distortion: k1, k2, p1, p2, k3.
    """
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    # Far outside the image the distortion's polynomial may lead back into it: hulls are cut off before.
    sides = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * (1 + 2 * MARGIN) - MARGIN
    shown = (sides * (camera.width, camera.height) - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    mask = np.zeros((camera.height, camera.width), np.uint8)
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    for box in boxes:
        if np.hypot(*box[7:9]) <= MOVING_SPEED:
            continue
        c, s = np.cos(box[6]), np.sin(box[6])
        vehicle = (corners * box[3:6]) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + box[:3]
        world = vehicle @ vehicle_to_world[:3, :3].T + vehicle_to_world[:3, 3]
        x, y, z = camera.world_to_cam[:3, :3] @ world.T + camera.world_to_cam[:3, 3:]
        if (z > 0.1).all():
            hull = cv2.convexHull(np.stack([x / z, y / z], axis=1).astype(np.float32))
            area, seen = cv2.intersectConvexConvex(hull, shown.astype(np.float32))
            if area > 0:
                ends = seen.reshape(-1, 2).astype(np.float64)
                points = ends[:, None] + np.linspace(0, 1, 8)[:, None] * (np.roll(ends, -1, axis=0) - ends)[:, None]
                rays = np.insert(points.reshape(-1, 2), 2, 1.0, axis=1)  # edges are bent
                pixels, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, np.array(distortion))
                cv2.fillPoly(mask, [pixels.round().astype(np.int32)], 1)
    return mask > 0
