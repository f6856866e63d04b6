"""Videos of cameras that move: structure from motion takes all frames in use, and their poses are the scene's."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from datasets import load_clip, load_clip_set
from datasets.cameras.color import ColorCorrection
from pipeline.config.schema import Config
from pipeline.data.prepared import Prepared
from pipeline.data.sfm.photograph import Photograph
from pipeline.data.sources.reconstruct import corrected_colors, normalised_unit


def from_clip(cfg: Config, log: Callable[[str], None]) -> Prepared:
    """Poses and points from the frames in use; the training images are these frames, undistorted and reduced."""
    from pipeline.data.sfm.cache import clip_reconstruct_cached

    clip = load_clip(cfg.scene, log=log)
    photographs = [Photograph(frame.name, clip.photograph(frame)) for frame in clip.frames]
    width, height = photographs[0].image.shape[1], photographs[0].image.shape[0]
    log(f"sfm: {len(photographs)} frames of {clip.source.name}, {width} x {height}")
    cloud, folder = clip_reconstruct_cached(photographs, cfg.init, clip.source, Path(cfg.scene.cache), log)
    summary, lens = cloud.summary(), next(iter(cloud.cameras.values()))
    log(
        f"sfm: {summary['registered']} of {len(photographs)} frames registered, {summary['points']} points, mean error "
        f"{summary['mean_error_px']:.2f} px, focal length {lens.camera.fx:.1f} px; cached in {folder}"
    )
    cameras = {name: found.camera for name, found in cloud.cameras.items()}
    scene = clip.to_scene(cameras, lens.radial, normalised_unit(cloud.points, list(cameras.values())))
    return Prepared(scene, cloud if cfg.init.source != "random" else None, folder, poses_estimated=True)


def from_clips(cfg: Config, log: Callable[[str], None]) -> Prepared:
    """As one clip; the frames of each camera share a lens, and all are in one reconstruction."""
    from pipeline.data.sfm.cache import clip_reconstruct_cached

    found = load_clip_set(cfg.scene, log=log)
    photographs = [
        Photograph(name, camera.clip.photograph(frame), lens=camera.name, time=camera.time(frame))
        for name, camera, frame in found.photographs()
    ]
    log(f"sfm: {len(photographs)} frames of {len(found.cameras)} cameras in {found.source.name}")
    corrected = bool(cfg.scene.color_correction)
    held_out = [camera.name for camera in found.cameras if camera.number in found.settings.test_cameras]
    cloud, folder = clip_reconstruct_cached(
        photographs, cfg.init, found.source, Path(cfg.scene.cache), log, observations=corrected
    )
    summary = cloud.summary()
    log(
        f"sfm: {summary['registered']} of {len(photographs)} frames registered, {summary['points']} points, mean error "
        f"{summary['mean_error_px']:.2f} px; cached in {folder}"
    )
    colors: dict[str, ColorCorrection] = {}
    if corrected:
        cloud, colors = corrected_colors(cfg, photographs, cloud, held_out, log)
    cameras = {name: calibrated.camera for name, calibrated in cloud.cameras.items()}
    radial = {p.lens: cloud.cameras[p.name].radial for p in photographs if p.name in cloud.cameras}
    unit = normalised_unit(cloud.points, list(cameras.values()))
    scene = found.to_scene(cameras, radial, unit, colors)
    return Prepared(scene, cloud if cfg.init.source != "random" else None, folder, poses_estimated=True)
