"""Where random points start, for cameras that look at one thing and for cameras that do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.data.initial_box import with_box_of_cameras, with_set_box
from pipeline.model.initialise import initialise
from rasterizer import Camera
from tests.helpers.tiny import tiny_config, tiny_scene


def test_random_points_before_cameras_side_by_side() -> None:
    """All are in an image at a depth of the band; their depths have a uniform logarithm."""
    scene = tiny_scene(static=True)
    cameras = []
    for x in np.linspace(-1, 1, len(scene.train)):
        pose = np.eye(4)
        pose[0, 3] = -x
        cameras.append(Camera(40, 30, 50.0, 50.0, 21.0, 14.0, pose))
    row = replace(scene, train=tuple(replace(view, camera=c) for view, c in zip(scene.train, cameras)))
    found, line = with_box_of_cameras(row)
    assert found.init_depths is not None and "0.55 to 11" in line
    cfg = tiny_config()
    mean = initialise(found, cfg, np.random.default_rng(0)).parameters["mean"][:, :3].numpy().astype(np.float64)
    depth = mean[:, 2]
    near, far = found.init_depths
    assert len(mean) == cfg.train.init_points and depth.min() >= near * 0.999 and depth.max() <= far * 1.001
    assert abs(np.log(depth).mean() - 0.5 * (np.log(near) + np.log(far))) < 0.3  # 200 of a spread of 0.9
    seen = np.zeros(len(mean), dtype=bool)
    for c in cameras:
        x, y = (mean[:, 0] - c.position[0]) / depth * c.fx + c.cx, mean[:, 1] / depth * c.fy + c.cy
        seen |= (x > -1e-3) & (x < c.width + 1e-3) & (y > -1e-3) & (y < c.height + 1e-3)
    assert seen.all()
    low, high = (np.asarray(corner) for corner in found.init_box)
    assert (mean >= low - 1e-6).all() and (mean <= high + 1e-6).all()


def test_a_usual_scene_keeps_its_box_and_a_set_one_is_taken() -> None:
    scene = tiny_scene()
    found, line = with_box_of_cameras(scene)
    assert found.init_depths is None and (found is scene) == (line == "")
    assert with_set_box(scene, [-2.0, 3.0]).init_box == (-2.0, 3.0)
