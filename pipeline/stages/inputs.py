"""What the result of each stage depends on, as hashes: a stage with unchanged inputs is skipped."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict

import numpy as np

from datasets import Scene
from pipeline.config.renamed_keys import with_first_names
from pipeline.config.schema import Config
from pipeline.data.prepared import Prepared
from pipeline.stages.decisions import MOTION, TIME_COLOUR
from pipeline.training.selection import motion, time_colour


def stage_inputs(cfg: Config, data: Prepared) -> dict[str, str]:
    """Stage -> hash of everything its result depends on, for the stages that this run has.

    Keys are hashed under their first names, so that a renamed key does not make a finished stage count as undone.
    """
    config, found = with_first_names(asdict(cfg)), {}
    initial = {key: value for key, value in config["train"].items() if key.startswith("init_")}
    beginning = [fingerprint(data.scene), config["ablation"], initial, config["scene"]["init_points"], cfg.seed]
    if not data.canonical.is_identity:  # a model must not continue in other coordinates
        beginning.append(asdict(data.canonical))
    if data.cloud is not None and data.sfm_folder is None:  # points that came with the data
        beginning.append(_digest(data.cloud.points, data.cloud.colors))
    if data.sfm_folder is not None:
        found["sfm"] = _hash(data.sfm_folder.name)
        beginning.append(found["sfm"])
    if data.scene.capture == "drive":
        beginning += [asdict(cfg.init), cfg.effective_fourier_order, config["train"]["densify"]["max_gaussians"]]
    if cfg.effective_background_model != "none":
        beginning += [cfg.effective_background_model, cfg.init.sphere_points, cfg.init.sphere_radius]
    if motion.due(cfg, data.scene):
        found[MOTION] = _hash("motion", *beginning, config["train"], config["scene"]["near"])
        beginning.append(found[MOTION])
    if time_colour.due(cfg, data.scene):
        found[TIME_COLOUR] = _hash(*beginning, config["train"], config["scene"]["near"])
        beginning.append(found[TIME_COLOUR])
    found["init"] = _hash(*beginning)
    found["train"] = _hash(found["init"], config["train"], config["scene"]["near"])
    found["evaluate"] = _hash(found["train"], config["evaluate"])
    found["view"] = _hash(found["evaluate"])
    return found


def fingerprint(scene: Scene) -> str:
    """Hash of a scene's images, masks, cameras, sweeps, times and bounds. Its folder does not matter."""
    digest = hashlib.blake2b(digest_size=16)
    digest.update(repr((scene.duration, scene.time_start, scene.background, scene.init_box)).encode())
    for view in scene.train + scene.test:
        c = view.camera
        digest.update(repr((view.name, view.time, c.width, c.height, c.fx, c.fy, c.cx, c.cy)).encode())
        digest.update(c.world_to_cam.tobytes())
        # A stored frame knows its checksum: a scene of 25 GB need not be read for this.
        known = getattr(view.image, "checksum", None)
        digest.update(np.ascontiguousarray(view.image).data if known is None else known.encode())
        for plane in (view.coverage, view.mask):
            if plane is not None:
                digest.update(np.ascontiguousarray(plane).data)
        for mask in (view.sky, view.moving):
            if mask is not None:
                digest.update(np.packbits(mask).data)
    for sweep in scene.sweeps + scene.test_sweeps:
        digest.update(repr((sweep.frame, sweep.time)).encode())
        digest.update(np.ascontiguousarray(sweep.points).data)
    return digest.hexdigest()


def _digest(*arrays: np.ndarray) -> str:
    digest = hashlib.blake2b(digest_size=16)
    for array in arrays:
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def _hash(*parts: object) -> str:
    return hashlib.blake2b(json.dumps(parts, sort_keys=True, default=str).encode(), digest_size=16).hexdigest()
