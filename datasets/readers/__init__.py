"""Readers, one module a layout, which scene.reader names; datasets/source.py says what a reader has.

dnerf              D-NeRF (Blender): transforms_train.json, transforms_test.json
plenoptic          Plenoptic Video: cam00.mp4 … and poses_bounds.npy, or images/ and transforms_*.json
video              videos or images in order, without poses
calibrated         videos or images of several cameras, with poses in a file (scene.calibration)
colmap             COLMAP: images/, sparse/0
nerfstudio         nerfstudio: transforms.json
dynamic_gaussians  Dynamic 3D Gaussians: train_meta.json, ims/
nerfies            Nerfies, HyperNeRF, DyCheck: dataset.json, camera/*.json, rgb/2x
llff               NVIDIA Dynamic Scenes: images/, poses_bounds.npy of one moving camera
kitti, waymo       driving logs
synthetic          scenes that datasets/synthetic makes, in the layouts of others
"""

from __future__ import annotations

import pkgutil


def reader_names() -> tuple[str, ...]:
    """The values of scene.reader: the modules of this folder, which are not imported here."""
    return tuple(sorted(module.name for module in pkgutil.iter_modules(__path__)))
